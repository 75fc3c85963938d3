"""The sweep as one writes it with pyvisa: set, wait, stop, fetch four channels, fit, next. Prints JSON.

Usage: sweep.py ADDRESSES FREQS, both JSON: addresses by role, frequencies in Hz.
"""

import csv
import json
import struct
import sys
import tempfile
import time

import numpy as np
import pyvisa


def main():
    addresses, freqs_hz = json.loads(sys.argv[1]), json.loads(sys.argv[2])
    manager = pyvisa.ResourceManager("@py")

    def connect(role):
        port = addresses[role].rsplit(":", 1)[1]
        return manager.open_resource(
            f"TCPIP::127.0.0.1::{port}::SOCKET", read_termination="\n", write_termination="\n", timeout=10_000
        )

    generator, supply, scope = connect("generator"), connect("supply4q"), connect("scope")
    generator.write("C1:OUTP LOAD,HZ")
    generator.write("C1:BSWV WVTP,SINE,FRQ,10,AMP,0.002,OFST,0")
    for message in ("OUTP OFF", "FUNC:MODE CURR", "VOLT 5", "CURR:LIM 3", "CURR:MODE EXT"):
        supply.write(message)
    generator.write("C1:OUTP ON")
    supply.write("OUTP ON")
    scope.write(":ACQ:MDEP 1M")
    for channel, (scale, offset) in enumerate([(0.02, 0.0), (0.02, 0.0), (0.04, 0.0), (0.08, -3.8)], 1):
        scope.write(f":CHAN{channel}:SWIT ON")
        scope.write(f":CHAN{channel}:SCAL {scale}")
        scope.write(f":CHAN{channel}:OFFS {offset}")
    for message in (":TRIG:TYPE EDGE", ":TRIG:EDGE:SOUR C2", ":TRIG:EDGE:LEV 0"):
        scope.write(message)
    scope.query("*IDN?")

    with tempfile.TemporaryFile("w", newline="") as file:
        rows = csv.writer(file)
        start = time.monotonic()
        for freq_hz in freqs_hz:
            generator.write(f"C1:BSWV FRQ,{freq_hz},AMP,1.0")
            least = 5.0 / freq_hz / 10.0
            decade = 10.0 ** np.floor(np.log10(least))
            scale = next(step * decade for step in (1, 2, 5, 10) if step * decade >= least * 0.999999)
            scope.write(f":TIM:SCAL {scale:.3e}")
            scope.write(":TRIG:MODE NORM")
            scope.write(":TRIG:RUN")
            time.sleep(11.0 / freq_hz + 1.0)
            scope.write(":TRIG:STOP")
            scope.query(":TRIG:STAT?")
            measured = time.monotonic()
            phasors = []
            for channel in range(1, 5):
                for message in (
                    f":WAV:SOUR C{channel}",
                    ":WAV:STAR 0",
                    ":WAV:POIN 0",
                    ":WAV:INT 100",
                    ":WAV:WIDT WORD",
                ):
                    scope.write(message)
                block = bytes(scope.query_binary_values(":WAV:PRE?", datatype="B", expect_termination=False))
                scope.read()
                scope.read()
                vdiv, offset, per_div = struct.unpack_from("<fff", block, 0x9C)
                (interval_s,) = struct.unpack_from("<f", block, 0xB0)
                codes = np.array(scope.query_binary_values(":WAV:DATA?", datatype="h", expect_termination=False))
                scope.read()
                scope.read()
                volts = codes / per_div * vdiv - offset
                t = np.arange(len(volts)) * interval_s * 100
                omega = 2 * np.pi * freq_hz
                design = np.stack([np.cos(omega * t), np.sin(omega * t), np.ones_like(t)], axis=1)
                a, b, _ = np.linalg.lstsq(design, volts, rcond=None)[0]
                phasors.append(complex(a, -b))
            c1, c2, c3, c4 = phasors
            z_ohm = (c4 - c3) / (c2 - c1) * 9.96e-3
            rows.writerow([freq_hz, z_ohm.real, z_ohm.imag])
            file.flush()
        recorded = time.monotonic()
    supply.write("OUTP OFF")
    supply.query("*OPC?")
    generator.write("C1:OUTP OFF")
    if not 0.004 < abs(z_ohm) < 0.02:
        sys.exit(f"the last impedance makes no sense: {z_ohm}")
    print(json.dumps({"measured_s": measured - start, "recorded_s": recorded - start}))


if __name__ == "__main__":
    main()
