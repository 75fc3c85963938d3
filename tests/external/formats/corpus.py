"""Real files of others, read by eis-bench and by the readers of others, number by number: read right, or refused.

    corpus.py EIS_BENCH [FOLDER]

FOLDER holds files of pyimpspec, impedance.py and PyEIS (default: ../shared/data/formats beside the
repository). Prints a table and ends with 1 where a file is read with other numbers than a peer
reads, or several of its spectra are made one.
"""

import csv
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

warnings.filterwarnings("ignore")

ROOT = Path(__file__).resolve().parents[3]
PROGRAM = Path(sys.argv[1]).resolve()
FOLDER = Path(sys.argv[2]) if len(sys.argv) > 2 else ROOT.parent / "shared/data/formats"
# Both sides read the same decimals; modulus and phase are turned into parts, which costs a few last digits.
TOLERANCE = 1e-6

# What impedance.py needs to know: the instrument by the file's name.
INSTRUMENTS = {
    "Autolab.txt": "autolab",
    "BioLogic.mpt": "biologic",
    "CHInstruments.txt": "chinstruments",
    ".DTA": "gamry",
    ".dta": "gamry",
    "Parstat.txt": "parstat",
    "Powersuite.txt": "powersuite",
    ".par": "versastudio",
    ".z": "zplot",
    ".mpt": "biologic",
}

# Where a peer is known to read a file otherwise than its header says: the file, the peer, why.
PEER_DIFFERS = {}


def of_pyimpspec(path):
    import pyimpspec

    return [
        list(zip(s.get_frequencies(masked=None), s.get_impedances(masked=None)))
        for s in pyimpspec.parse_data(str(path))
    ]


def of_impedance_py(path):
    from impedance import preprocessing

    instrument = next((name for end, name in INSTRUMENTS.items() if path.name.endswith(end)), None)
    if instrument is None:
        if path.parent.name != "impedance_py":
            raise ValueError("no instrument")
        f, z = preprocessing.readCSV(str(path))
    else:
        f, z = preprocessing.readFile(str(path), instrument=instrument)
    return [list(zip(f, z))]


def of_galvani(path):
    from galvani import BioLogic

    if not path.name.endswith(".mpt"):
        raise ValueError("no .mpt")
    rows, _ = BioLogic.MPTfile(str(path), encoding="latin1")
    return [[(r["freq/Hz"], complex(r["Re(Z)/Ohm"], -r["-Im(Z)/Ohm"])) for r in rows if r["freq/Hz"] != 0]]


# Those that do not part spectra give them all in one.
PEERS = {"pyimpspec": (of_pyimpspec, True), "impedance.py": (of_impedance_py, False), "galvani": (of_galvani, False)}


def ours(path):
    """Spectra by name, or why the file was refused."""
    with tempfile.TemporaryDirectory(prefix="eis-bench-corpus-") as out:
        done = subprocess.run(
            [str(PROGRAM), "convert", str(path), "--to", "csv", "--out", out], capture_output=True, text=True
        )
        if done.returncode != 0:
            return None, (done.stderr.strip().splitlines() or [f"ended with {done.returncode}"])[-1]
        files = [Path(line.rsplit(": ", 1)[0]) for line in done.stdout.splitlines()]
        read = {}
        for file in files:
            rows = list(csv.DictReader(file.open()))
            read[file.name.removesuffix(".csv")] = [
                (float(r["freq_hz"]), complex(float(r["z_re_ohm"]), float(r["z_im_ohm"]))) for r in rows
            ]
        return read, done.stderr.strip()


def ordered(points):
    return sorted(((float(f), complex(z)) for f, z in points), key=lambda p: (p[0], p[1].real, p[1].imag))


def worst(a, b):
    """Largest relative difference; none where the numbers of points differ."""
    a, b = ordered(a), ordered(b)
    if len(a) != len(b):
        return None
    return max(max(abs(f / g - 1), abs(y - z) / max(abs(y), abs(z), 1e-300)) for (f, y), (g, z) in zip(a, b))


def compare(theirs, parts, read):
    """Worst difference, and whether it will do."""
    spectra = list(read.values())
    if not parts:
        # All in one, or one of several.
        [whole] = theirs
        differences = [d for d in (worst(points, whole) for points in [sum(spectra, []), *spectra]) if d is not None]
        return (
            (f"{min(differences):.1e}", min(differences) <= TOLERANCE)
            if differences
            else (f"{len(sum(spectra, []))} points against {len(whole)}", False)
        )
    if len(spectra) != len(theirs):
        return f"{len(spectra)} spectra against {len(theirs)}", False
    differences = [worst(a, b) for a, b in zip(spectra, theirs)]
    if any(d is None for d in differences):
        return f"{[len(s) for s in spectra]} points against {[len(t) for t in theirs]}", False
    return f"{max(differences):.1e}", max(differences) <= TOLERANCE


def main():
    if not FOLDER.is_dir():
        print(f"files of other programs, number by number: skipped: no {FOLDER}")
        return 0
    counts = {"right": 0, "refused": 0, "alone": 0, "wrong": 0}
    print("file | peer: points | ours | worst relative difference, or why it is refused")
    for path in sorted(p for p in FOLDER.glob("*/*") if p.is_file() and p.name != "LICENSE"):
        name = f"{path.parent.name}/{path.name}"
        read, message = ours(path)
        peers = {}
        for peer, (reader, parts) in PEERS.items():
            try:
                peers[peer] = (reader(path), parts)
            except BaseException as error:  # noqa: BLE001 - a peer may do anything with a file that is not its own
                if isinstance(error, KeyboardInterrupt):
                    raise
        points = (
            ", ".join(f"{peer}: {'+'.join(str(len(s)) for s in theirs)}" for peer, (theirs, _) in peers.items())
            or "none reads it"
        )
        if read is None:
            counts["refused"] += 1
            message = message.removeprefix("eis-bench: ").removeprefix(f"{path}").lstrip(":, ")
            print(f"{name} | {points} | refused | {message}")
            continue
        met = "+".join(str(len(s)) for s in read.values())
        verdicts = {peer: compare(theirs, parts, read) for peer, (theirs, parts) in peers.items()}
        wrong = [peer for peer, (_, good) in verdicts.items() if not good and (name, peer) not in PEER_DIFFERS]
        kind = "wrong" if wrong else "right" if any(good for _, good in verdicts.values()) else "alone"
        counts[kind] += 1
        text = ", ".join(
            f"{peer} {text}" + (f" ({PEER_DIFFERS[name, peer]})" if not good and (name, peer) in PEER_DIFFERS else "")
            for peer, (text, good) in verdicts.items()
        )
        mark = "  <-- WRONG" if wrong else ""
        print(f"{name} | {points} | {met} | {text or 'no peer to compare with'}{mark}")
    print(", ".join(f"{count} {kind}" for kind, count in counts.items()))
    return 1 if counts["wrong"] else 0


sys.exit(main())
