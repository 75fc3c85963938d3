"""Clients that others wrote for the real instruments do their documented work against the simulated ones.

Usage: clients.py EIS_BENCH CONFIGS
  EIS_BENCH  the program
  CONFIGS    the folder with benches/demo.toml and benches/mixed.toml

One line for each client: `ok`, `skipped` with the reason where the client itself cannot, or `FAILED`. Ends
with 1 where one failed.
"""

import asyncio
import contextlib
import json
import math
import os
import pathlib
import socket
import statistics
import subprocess
import sys
import tempfile
import time
import traceback

import pyvisa


class Skip(Exception):
    """The client itself cannot; why."""


def expect(what, met, expected, tolerance=None):
    good = met == expected if tolerance is None else abs(met - expected) <= tolerance
    if not good:
        within = "" if tolerance is None else f" within {tolerance}"
        raise AssertionError(f"{what}: expected {expected!r}{within}, met {met!r}")


@contextlib.contextmanager
def mocks(program, bench, *more):
    """The simulated instruments of a bench on real ports; gives their addresses by role."""
    command = [program, "mock", str(bench), "--time", "real", "--json", "--seed", "1", *more]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield json.loads(process.stdout.readline())["addresses"]
    finally:
        process.terminate()
        process.wait(20)


def port(address):
    return int(address.rsplit(":", 1)[1])


def visa(address):
    return f"TCPIP0::127.0.0.1::{port(address)}::SOCKET"


SOCKET = {"visa_library": "@py", "read_termination": "\n", "write_termination": "\n", "timeout": 10_000}


# The A models: demo.toml


def pymeasure_sds1000xhd(a):
    from pymeasure.instruments.siglenttechnologies import SDS1000XHD

    generator = pyvisa.ResourceManager("@py").open_resource(
        visa(a["generator"]), read_termination="\n", write_termination="\n"
    )
    supply = pyvisa.ResourceManager("@py").open_resource(
        visa(a["supply4q"]), read_termination="\n", write_termination="\n"
    )
    scope = SDS1000XHD(visa(a["scope"]), **SOCKET)
    try:
        jig = socket.create_connection(("127.0.0.1", port(a["jig"])))
        jig.sendall(b"JIG:MOUNT FAKE\n")
        jig.close()
        # Two amperes through the fake cell: ±54 mV at channel 2.
        generator.write("C1:OUTP LOAD,HZ")
        generator.write("C1:BSWV WVTP,SINE,FRQ,100,AMP,2,OFST,0,PHSE,0")
        generator.write("C1:OUTP ON")
        for message in ("FUNC:MODE CURR", "CURR:LIM 5", "VOLT 5", "CURR:MODE EXT", "OUTP ON"):
            supply.write(message)
        expect("SYST:ERR?", supply.query("SYST:ERR?").split(",")[0].strip().lstrip("+"), "0")
        for channel in (scope.channel_1, scope.channel_2):
            channel.display_enabled = True
            channel.coupling = "DC"
            channel.probe = 1
            # A third of a division at most: the client ends a block at the first byte 0A, which a
            # socket cannot mark as data.
            channel.scale = 0.2
            channel.offset = 0
        expect("scale", scope.channel_2.scale, 0.2, 1e-9)
        expect("probe", scope.channel_2.probe, 1.0)
        scope.timebase.scale = 0.005
        expect("time base", scope.timebase.scale, 0.005, 1e-9)
        scope.acquisition.memory_depth = "10K"
        scope.trigger.mode = "AUTO"
        scope.trigger.run()
        time.sleep(1.0)
        scope.trigger.stop()
        waveform = scope.wf_C2
        waveform.source = "C2"
        waveform.interval = 1
        waveform.point = 0
        # After the block comes 0A 0A, as from the instrument; the client leaves the second one
        # unread, so nothing is asked after it.
        points = scope.acquisition.points
        times, volts = waveform.get_data()
        expect("points", len(volts), points)
        expect("span", times[-1] - times[0], 0.05, 1e-4)
        amplitude = math.sqrt(2.0) * statistics.pstdev(volts)
        # 2 V of amplitude peak to peak is 1 V, at 2 A/V and 27 mΩ.
        expect("amplitude at channel 2", amplitude, 0.053, 0.005)
    finally:
        for message in ("OUTP OFF", "CURR:MODE FIX"):
            supply.write(message)
        supply.query("*OPC?")
        generator.write("C1:OUTP OFF")
        generator.query("*IDN?")
        for one in (supply, generator):
            one.close()
        scope.adapter.close()


def pymeasure_teledyne_t3afg(a):
    from pymeasure.instruments.teledyne import TeledyneT3AFG

    generator = TeledyneT3AFG(visa(a["generator"]), **SOCKET)
    with contextlib.closing(generator.adapter):
        channel = generator.ch_1
        channel.wavetype = "SINE"
        channel.frequency = 123.0
        channel.amplitude = 1.5
        channel.offset = -0.25
        channel.output_enabled = True
        expect("wave", channel.wavetype, "SINE")
        expect("frequency", channel.frequency, 123.0, 1e-6)
        expect("amplitude", channel.amplitude, 1.5, 1e-6)
        expect("offset", channel.offset, -0.25, 1e-6)
        expect("output", channel.output_enabled, True)
        channel.output_enabled = False
        expect("output", channel.output_enabled, False)


def pymeasure_kepco(a):
    from pymeasure.instruments.kepco import KepcoBOP3612

    supply = KepcoBOP3612(visa(a["supply4q"]), visa_library="@py", timeout=10_000)
    with contextlib.closing(supply.adapter):
        expect("maker", supply.id.split(",")[0], "KEPCO")
        supply.operating_mode = "CURR"
        expect("mode", supply.operating_mode, "CURR")
        supply.current_setpoint = 0.5
        supply.voltage_setpoint = 2.0
        expect("current", supply.current_setpoint, 0.5, 1e-3)
        expect("voltage", supply.voltage_setpoint, 2.0, 1e-3)
        supply.current_setpoint = 0
        expect("output", supply.output_enabled, False)
        supply.output_enabled = True
        expect("output", supply.output_enabled, True)
        expect("measured current", supply.current, 0.0, 0.05)
        supply.output_enabled = False
        expect("output", supply.output_enabled, False)
        expect("errors", len(supply.check_errors()), 0)


def pymeasure_spd(a):
    from pymeasure.instruments.siglenttechnologies import SPD1305X

    supply = SPD1305X(visa(a["supply"]), **SOCKET)
    with contextlib.closing(supply.adapter):
        channel = supply.ch_1
        channel.voltage_setpoint = 1.25
        channel.current_limit = 0.2
        expect("voltage", channel.voltage_setpoint, 1.25, 1e-3)
        expect("current limit", channel.current_limit, 0.2, 1e-3)
        channel.enable_output(False)
        expect("measured current", channel.current, 0.0, 0.01)
        if not supply.id.startswith("Siglent"):
            raise AssertionError(supply.id)


def qcodes_siglent(a):
    from qcodes_contrib_drivers.drivers.Siglent.sdg import Siglent_SDG_2042X

    generator = Siglent_SDG_2042X(
        "sdg", f"TCPIP0::127.0.0.1::{port(a['generator'])}::SOCKET", visalib="@py", terminator="\n"
    )
    with contextlib.closing(generator):
        channel = generator.channel1
        channel.wave_type("sine")
        channel.frequency(77.0)
        channel.amplitude(0.8)
        channel.offset(0.1)
        expect("frequency", channel.frequency(), 77.0, 1e-6)
        expect("amplitude", channel.amplitude(), 0.8, 1e-6)
        expect("offset", channel.offset(), 0.1, 1e-6)
        channel.enabled(True)
        expect("output", channel.enabled(), True)
        channel.enabled(False)
        expect("output", channel.enabled(), False)


def julabo_asyncio(a):
    from julabo import JulaboCF, connection_for_url

    async def work():
        connection = connection_for_url(f"tcp://127.0.0.1:{port(a['chiller'])}")
        await connection.open()
        chiller = JulaboCF(connection)
        if not (await chiller.identification()).startswith("JULABO"):
            raise AssertionError("identification")
        await chiller.set_point_1(22.5)
        expect("set-point", await chiller.set_point_1(), 22.5, 1e-6)
        await chiller.start()
        expect("started", await chiller.is_started(), True)
        expect("status", await chiller.status(), "03 REMOTE START")
        expect("bath", await chiller.bath_temperature(), 22.0, 3.0)
        await chiller.stop()
        expect("started", await chiller.is_started(), False)
        await connection.close()

    asyncio.run(work())


def pyvisa_block(a):
    """The samples of the scope, as a script of a few lines fetches them."""
    scope = pyvisa.ResourceManager("@py").open_resource(
        visa(a["scope"]), read_termination="\n", write_termination="\n", timeout=10_000
    )
    with contextlib.closing(scope):
        identity = scope.query("*IDN?")
        expect("maker", identity.split(",")[0], "Siglent Technologies")
        scope.write(":TRIG:MODE AUTO")
        scope.write(":TRIG:RUN")
        time.sleep(0.5)
        scope.write(":TRIG:STOP")
        for message in (":WAV:SOUR C1", ":WAV:STAR 0", ":WAV:INT 1", ":WAV:POIN 500", ":WAV:WIDT WORD"):
            scope.write(message)
        codes = scope.query_binary_values(":WAV:DATA?", datatype="h", is_big_endian=False, expect_termination=False)
        expect("points", len(codes), 500)
        # The block ends with 0A 0A: what follows reads an empty line first.
        scope.flush(pyvisa.constants.BufferOperation.discard_read_buffer)


# The B models: mixed.toml


def pymeasure_agilent33500(b):
    from pymeasure.instruments.agilent import Agilent33500

    generator = Agilent33500(visa(b["generator"]), **SOCKET)
    with contextlib.closing(generator.adapter):
        channel = generator.ch_1
        channel.shape = "SIN"
        channel.output_load = "INF"
        channel.frequency = 321.0
        channel.amplitude = 0.6
        channel.offset = 0.2
        expect("shape", channel.shape, "SIN")
        expect("frequency", channel.frequency, 321.0, 1e-6)
        expect("amplitude", channel.amplitude, 0.6, 1e-6)
        expect("offset", channel.offset, 0.2, 1e-6)
        channel.output = True
        expect("output", channel.output, True)
        channel.output = False
        expect("errors", len(generator.check_errors()), 0)


def qcodes_keysight(b):
    from qcodes.instrument_drivers.Keysight import Keysight33512B

    generator = Keysight33512B(
        "wg", f"TCPIP0::127.0.0.1::{port(b['generator'])}::SOCKET", visalib="@py", terminator="\n", silent=True
    )
    with contextlib.closing(generator):
        channel = generator.ch1
        channel.function_type("SIN")
        channel.frequency(55.0)
        channel.amplitude(0.4)
        channel.offset(0.1)
        expect("frequency", channel.frequency(), 55.0, 1e-6)
        expect("amplitude", channel.amplitude(), 0.4, 1e-6)
        expect("offset", channel.offset(), 0.1, 1e-6)
        channel.output("ON")
        expect("output", channel.output(), "ON")
        channel.output("OFF")
        expect("error", generator.error()[0], 0)


def pymeasure_e36312a(b):
    from pymeasure.instruments.keysight import KeysightE36312A

    supply = KeysightE36312A(visa(b["supply"]), **SOCKET)
    with contextlib.closing(supply.adapter):
        channel = supply.ch_1
        channel.voltage_setpoint = 3.3
        channel.current_limit = 0.25
        expect("voltage", channel.voltage_setpoint, 3.3, 1e-3)
        expect("current limit", channel.current_limit, 0.25, 1e-3)
        expect("output", channel.output_enabled, False)
        expect("measured current", channel.current, 0.0, 0.01)
        expect("errors", len(supply.check_errors()), 0)


# The other way round: our driver against a simulator of others


def our_julabo_driver(program):
    """`eis-bench doctor` reads the bath, sets a set-point, starts and stops.

    The simulator shows the set-point afterwards.
    """
    from julabo import JulaboCF, connection_for_url

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        number = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        config = folder / "simulator.yml"
        config.write_text(
            "devices:\n- class: JulaboCF\n  package: julabo.simulator\n  name: julabo-1\n"
            f"  transports:\n  - type: tcp\n    url: 127.0.0.1:{number}\n"
        )
        bench = folder / "bench.toml"
        bench.write_text(
            f'name = "chiller"\n[instruments.chiller]\nmodel = "julabo"\naddress = "tcp://127.0.0.1:{number}"\n'
            '[wiring]\ngenerator_channel = 1\ncommand_trim = 1.0\ncommand_offset = "0 V"\n'
            'scale_per_ampere = ["20 mV", "20 mV", "40 mV", "80 mV"]\n[wiring.shunt]\nresistance = "9.96 mΩ"\n'
            'resistance_sigma = "2 µΩ"\ninductance = "0 nH"\ninductance_sigma = "0.1 nH"\n'
        )
        server = subprocess.Popen(
            [sys.executable, "-m", "sinstruments.simulator", "-c", str(config)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            for _ in range(100):
                with contextlib.suppress(OSError):
                    socket.create_connection(("127.0.0.1", number)).close()
                    break
                time.sleep(0.1)

            async def client(work):
                connection = connection_for_url(f"tcp://127.0.0.1:{number}")
                await connection.open()
                try:
                    return await work(JulaboCF(connection))
                finally:
                    await connection.close()

            # It starts in manual mode, which our driver refuses; a first command takes it to remote
            # mode, as its panel would.
            asyncio.run(client(lambda chiller: chiller.stop()))
            identified = subprocess.run([program, "identify", str(bench), "--json"], capture_output=True, text=True)
            expect("exit code of identify", identified.returncode, 0)
            expect("model", json.loads(identified.stdout)[0]["model"], "julabo")
            examined = subprocess.run(
                [program, "doctor", str(bench), "--json", "--out", str(folder / "report")],
                capture_output=True,
                text=True,
            )
            expect("exit code of doctor", examined.returncode, 0)
            checks = {check["id"]: check for check in json.loads(examined.stdout)["checks"]}
            expect("bath", checks["meters.thermometers"]["met"], "bath 29.4 °C")
            expect("chiller.obeys", checks["chiller.obeys"]["verdict"], "ok")
            expect("set-point", asyncio.run(client(lambda chiller: chiller.set_point_1())), 29.0, 1e-6)
        finally:
            server.terminate()
            server.wait(20)


# pyvisa-py over VXI-11 and HiSLIP


def resource(address):
    """`vxi11:HOST:PORT/inst0` and `hislip:HOST:PORT/hislip0` as VISA writes them."""
    kind, rest = address.split(":", 1)
    socket_text, device = rest.split("/", 1)
    host, number = socket_text.rsplit(":", 1)
    return (
        f"TCPIP0::{host},{number}::{device}::INSTR" if kind == "vxi11" else f"TCPIP0::{host}::{device},{number}::INSTR"
    )


def visa_instr(resource_name):
    manager = pyvisa.ResourceManager("@py")
    scope = manager.open_resource(resource_name, timeout=10_000)
    with contextlib.closing(scope):
        for _ in range(3):
            if not scope.query("*IDN?").startswith("Siglent Technologies"):
                raise AssertionError("identity")
        scope.write(":TRIG:MODE AUTO")
        scope.write(":TRIG:RUN")
        time.sleep(0.5)
        scope.write(":TRIG:STOP")
        for message in (":WAV:SOUR C1", ":WAV:STAR 0", ":WAV:INT 1", ":WAV:POIN 500", ":WAV:WIDT WORD"):
            scope.write(message)
        codes = scope.query_binary_values(":WAV:DATA?", datatype="h", is_big_endian=False)
        expect("points", len(codes), 500)
        scope.read_stb()
        scope.clear()
        if not scope.query("*IDN?").startswith("Siglent Technologies"):
            raise AssertionError("identity after a clear")


def run(name, work):
    start = time.monotonic()
    try:
        work()
        print(f"ok       {name} ({time.monotonic() - start:.1f} s)", flush=True)
        return "ok"
    except Skip as reason:
        print(f"skipped  {name}: {reason}", flush=True)
        return "skipped"
    except Exception as error:
        print(f"FAILED   {name}: {type(error).__name__}: {error}", flush=True)
        if os.environ.get("VERBOSE"):
            traceback.print_exc()
        return "FAILED"


def main():
    program, configs = sys.argv[1], pathlib.Path(sys.argv[2])
    only = sys.argv[3:]
    outcomes = []
    a_clients = [
        ("pyvisa-py on a raw socket, block of samples", pyvisa_block),
        ("PyMeasure SDS1000XHD", pymeasure_sds1000xhd),
        ("PyMeasure TeledyneT3AFG", pymeasure_teledyne_t3afg),
        ("PyMeasure KepcoBOP3612", pymeasure_kepco),
        ("PyMeasure SPD1305X", pymeasure_spd),
        ("QCoDeS Siglent_SDG_2042X", qcodes_siglent),
        ("julabo, asyncio", julabo_asyncio),
    ]
    b_clients = [
        ("PyMeasure Agilent33500", pymeasure_agilent33500),
        ("QCoDeS Keysight33512B", qcodes_keysight),
        ("PyMeasure KeysightE36312A", pymeasure_e36312a),
    ]
    for bench, clients in (("demo", a_clients), ("mixed", b_clients)):
        with mocks(program, configs / "benches" / f"{bench}.toml") as addresses:
            for name, work in clients:
                if not only or any(word in name for word in only):
                    outcomes.append(run(name, lambda: work(addresses)))
    over = [("VXI-11", "vxi11"), ("HiSLIP", "hislip")]
    for transport, word in over:
        with mocks(program, configs / "benches" / "demo.toml", "--over", f"scope={word}") as addresses:
            name = f"pyvisa-py over {transport}"
            if not only or transport in only:
                outcomes.append(run(name, lambda: visa_instr(resource(addresses["scope"]))))
    if not only or "sinstruments" in only:
        outcomes.append(run("our Julabo driver against sinstruments", lambda: our_julabo_driver(program)))
    counts = {word: outcomes.count(word) for word in ("ok", "skipped", "FAILED")}
    print(f"clients of others: {counts['ok']} ok, {counts['skipped']} skipped, {counts['FAILED']} failed", flush=True)
    return 1 if counts["FAILED"] else 0


if __name__ == "__main__":
    sys.exit(main())
