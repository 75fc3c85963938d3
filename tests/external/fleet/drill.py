"""Breaks a fleet of real servers, and counts from their run folders how often each job was run."""

import argparse
import json
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
EXPERIMENT = """name = "tiny"
bench = "../benches/demo.toml"
cell = "../cells/p45b.toml"
seed = 1

[eis]
start = "100 Hz"
stop = "300 Hz"
points = 2
amplitude = "1 A"
periods = 11
extra_wait = "1 s"

[fit]
rc = [1]
objective = "complex"
"""


def free_port() -> int:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        return bound.getsockname()[1]


class Broker:
    """A NATS server that can be killed."""

    def __init__(self, folder: Path):
        self.folder, self.port, self.kills = folder, free_port(), 0
        self.process: subprocess.Popen | None = None
        self.start()

    def start(self) -> None:
        arguments = ["-js", "-sd", str(self.folder), "-a", "127.0.0.1", "-p", str(self.port)]
        self.process = subprocess.Popen(["nats-server", *arguments], stderr=subprocess.DEVNULL)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        self.kills += 1

    def memory_mb(self) -> float:
        return memory_mb(self.process.pid)


class Network:
    """Passes connections on to the broker until it is cut."""

    def __init__(self, port: int):
        self.target, self.is_cut, self.open = port, False, []
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self) -> None:
        while True:
            client, _ = self.listener.accept()
            if self.is_cut:
                client.close()
                continue
            try:
                server = socket.create_connection(("127.0.0.1", self.target))
            except OSError:
                client.close()
                continue
            self.open += [client, server]
            for source, sink in ((client, server), (server, client)):
                threading.Thread(target=self.copy, args=(source, sink), daemon=True).start()

    def copy(self, source: socket.socket, sink: socket.socket) -> None:
        try:
            while data := source.recv(65536):
                sink.sendall(data)
        except OSError:
            pass
        for one in (source, sink):
            try:
                one.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass

    def cut(self, is_cut: bool) -> None:
        self.is_cut = is_cut
        while is_cut and self.open:
            one = self.open.pop()
            try:
                one.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
            one.close()


class Serve:
    """A server with several benches and its agent, in a folder of its own."""

    def __init__(self, drill: "Drill", number: int):
        self.program, self.number, self.kills = drill.arguments.program, number, 0
        self.fleet_program, self.agent_kills = drill.arguments.fleet_program, 0
        self.folder = drill.folder / f"s{number:02}"
        shutil.copytree(ROOT / "configs" / "cells", self.folder / "cells")
        shutil.copytree(ROOT / "configs" / "scenarios", self.folder / "scenarios")
        for part in ("benches", "experiments"):
            (self.folder / part).mkdir()
        bench = (ROOT / "configs" / "benches" / "demo.toml").read_text()
        names = [f"b{bench:02}" for bench in range(drill.arguments.benches)]
        for name in names:
            text = bench.replace('name = "demo"', f'name = "{name}"', 1)
            (self.folder / "benches" / f"{name}.toml").write_text(text)
        # A third is beyond the network that is cut.
        port = drill.network.port if number % 3 == 0 else drill.broker.port
        benches = ", ".join(f'"benches/{name}.toml"' for name in names)
        own = free_port()
        (self.folder / "serve.toml").write_text(
            f'listen = "127.0.0.1:{own}"\ndata = "data"\nconfigs = "."\nbenches = [{benches}]\n'
        )
        (self.folder / "fleet.toml").write_text(
            f'name = "drill"\nsite = "s{number:02}"\nlease = "10 s"\ndata = "agent"\n'
            f'server = "nats://127.0.0.1:{port}"\nbench_server = "http://127.0.0.1:{own}"\n'
            f'listen = "127.0.0.1:0"\n'
        )
        self.process: subprocess.Popen | None = None
        self.agent: subprocess.Popen | None = None
        self.start()
        self.start_agent()

    def begin(self, program: str, word: str, name: str) -> subprocess.Popen:
        with (self.folder / f"{word}.log").open("a") as log:
            return subprocess.Popen(
                [program, word, str(self.folder / name)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )

    def start(self) -> None:
        self.process = self.begin(self.program, "serve", "serve.toml")

    def start_agent(self) -> None:
        self.agent = self.begin(self.fleet_program, "agent", "fleet.toml")

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        self.kills += 1

    def kill_agent(self) -> None:
        self.agent.kill()
        self.agent.wait()
        self.agent_kills += 1

    def end(self) -> None:
        for process in (self.agent, self.process):
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
                process.wait()


def memory_mb(pid: int) -> float:
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    resident = [line for line in status.splitlines() if line.startswith("VmRSS")]
    return float(resident[0].split()[1]) / 1024.0 if resident else 0.0


class Drill:
    """The fleet, and what is done to it."""

    def __init__(self, arguments: argparse.Namespace, folder: Path):
        self.arguments, self.folder = arguments, folder
        self.broker = Broker(folder / "nats")
        self.network = Network(self.broker.port)
        self.serves = [Serve(self, number) for number in range(arguments.serves)]
        self.cut_serves = 0

    def fleet(self, *more: str) -> dict:
        server = f"nats://127.0.0.1:{self.broker.port}"
        command = [self.arguments.fleet_program, "--fleet", "drill", "--server", server, "--json"]
        done = subprocess.run([*command, *more], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise RuntimeError(done.stderr)
        return json.loads(done.stdout)

    def submit(self) -> list[str]:
        path = self.folder / "tiny.toml"
        path.write_text(EXPERIMENT)
        return self.fleet("submit", str(path), "--count", str(self.arguments.jobs))["jobs"]

    def wait_for_benches(self) -> None:
        wanted = self.arguments.serves * self.arguments.benches
        while True:
            try:
                benches = self.fleet("status")["benches"]
            except RuntimeError:
                benches = []
            if sum(bench["state"] == "idle" for bench in benches) == wanted:
                return
            time.sleep(1.0)

    def break_things(self) -> None:
        arguments = self.arguments
        rounds = max(arguments.broker_kills, 1)
        killed: list[Serve] = []
        without_agent: list[Serve] = []
        cut_at = None
        for number in range(rounds):
            time.sleep(arguments.every)
            for serve in killed:
                serve.start()
            for serve in without_agent:
                serve.start_agent()
            share = arguments.serve_kills * (number + 1) // rounds
            share -= arguments.serve_kills * number // rounds
            killed = random.sample(self.serves, min(share, len(self.serves)))
            for serve in killed:
                serve.kill()
            without_agent = random.sample(self.serves, min(share, len(self.serves)))
            for serve in without_agent:
                serve.kill_agent()
            if arguments.broker_kills:
                self.broker.kill()
                time.sleep(1.5)
                self.broker.start()
            if arguments.cut_s and number == rounds // 4:
                self.network.cut(True)
                cut_at, self.cut_serves = time.monotonic(), (arguments.serves + 2) // 3
            if cut_at and time.monotonic() - cut_at > arguments.cut_s:
                self.network.cut(False)
        while cut_at and time.monotonic() - cut_at < arguments.cut_s:
            time.sleep(1.0)
        self.network.cut(False)
        for serve in killed:
            serve.start()
        for serve in without_agent:
            serve.start_agent()

    def wait_for_jobs(self) -> dict:
        until = time.monotonic() + self.arguments.patience
        counts: dict = {}
        while time.monotonic() < until:
            try:
                counts = self.fleet("status", "--state", "lost")["jobs"]
            except RuntimeError:
                continue
            if sum(counts[state] for state in ("done", "failed", "cancelled")) == self.arguments.jobs:
                break
            time.sleep(3.0)
        for job in self.fleet("status", "--all", "--state", "failed")["listed"]:
            print(job["job"], job["bench"], job["words"], file=sys.stderr)
        return counts

    def end(self) -> None:
        for serve in self.serves:
            serve.end()
        self.broker.process.kill()
        self.broker.process.wait()


class Witness:
    """What the disks of the servers hold; the fleet's records are not asked."""

    def __init__(self, serves: list[Serve]):
        self.folders: dict[str, int] = {}
        self.begun_more = self.unfinished = self.overlaps = self.busy = 0
        for serve in serves:
            data = serve.folder / "data"
            spans: dict[str, list[tuple[float, float]]] = {}
            for folder in (data / "runs").iterdir():
                job = folder.name.removeprefix("tiny-")
                self.folders[job] = self.folders.get(job, 0) + 1
                self.look_at(folder)
                self.span(data, folder, spans)
            self.overlaps += sum(overlaps(one) for one in spans.values())
            for record in (data / "jobs").iterdir():
                ended = json.loads(record.read_text())["ended"] or {}
                self.busy += ended.get("code") == 8

    def look_at(self, folder: Path) -> None:
        journal = folder / "journal.jsonl"
        lines = journal.read_text().splitlines() if journal.exists() else []
        entries = [json.loads(line)["entry"] for line in lines]
        begins = sum("started" in entry for entry in entries if isinstance(entry, dict))
        self.begun_more += begins > 1
        last = entries[-1] if entries else None
        finished = isinstance(last, dict) and last.get("ended", {}).get("how") == "finished"
        self.unfinished += not finished

    def span(self, data: Path, folder: Path, spans: dict) -> None:
        record = json.loads((data / "jobs" / f"{folder.name}.json").read_text())
        sums = folder / "SHA256SUMS"
        if sums.exists():
            begun = record["item"]["process"]["started_unix_s"]
            spans.setdefault(record["item"]["bench"], []).append((begun, sums.stat().st_mtime))


def overlaps(spans: list[tuple[float, float]]) -> int:
    spans.sort()
    return sum(after[0] < before[1] for before, after in zip(spans, spans[1:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--program", required=True)
    parser.add_argument("--fleet-program", required=True)
    parser.add_argument("--serves", type=int, default=20)
    parser.add_argument("--benches", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=2000)
    parser.add_argument("--broker-kills", type=int, default=20)
    parser.add_argument("--serve-kills", type=int, default=50)
    parser.add_argument("--cut-s", type=float, default=120.0)
    parser.add_argument("--every", type=float, default=10.0, help="seconds between two kills")
    parser.add_argument("--patience", type=float, default=2400.0)
    arguments = parser.parse_args()
    random.seed(1)
    with tempfile.TemporaryDirectory(prefix="eis-fleet-") as folder:
        drill = Drill(arguments, Path(folder))
        drill.wait_for_benches()
        begun = time.monotonic()
        jobs = drill.submit()
        drill.break_things()
        counts = drill.wait_for_jobs()
        took = time.monotonic() - begun
        broker_mb = drill.broker.memory_mb()
        serve_mb = [memory_mb(serve.process.pid) for serve in drill.serves]
        agent_mb = [memory_mb(serve.agent.pid) for serve in drill.serves]
        drill.end()
        seen = Witness(drill.serves)
        once = sum(seen.folders.get(job, 0) == 1 for job in jobs)
        rows = {
            "servers": arguments.serves,
            "benches": arguments.serves * arguments.benches,
            "jobs": len(jobs),
            "broker killed and restarted": drill.broker.kills,
            "servers killed": sum(serve.kills for serve in drill.serves),
            "agents killed": sum(serve.agent_kills for serve in drill.serves),
            "agents cut off": f"{drill.cut_serves} for {arguments.cut_s:.0f} s",
            "jobs with one run folder": once,
            "jobs with several": sum(count > 1 for count in seen.folders.values()),
            "jobs with none": sum(job not in seen.folders for job in jobs),
            "runs that began more than once": seen.begun_more,
            "runs that did not finish": seen.unfinished,
            "runs that overlap on a bench": seen.overlaps,
            "runs refused, their bench in use": seen.busy,
            "done / failed by the fleet": f"{counts.get('done')} / {counts.get('failed')}",
            "time": f"{took:.0f} s",
            "memory of the broker": f"{broker_mb:.0f} MB",
            "memory of a server": f"{sum(serve_mb) / len(serve_mb):.0f} MB",
            "memory of an agent": f"{sum(agent_mb) / len(agent_mb):.0f} MB",
        }
        for what, value in rows.items():
            print(f"{what:<36} {value:>14}")
        bad = len(jobs) - once + seen.begun_more + seen.unfinished + seen.overlaps + seen.busy
        raise SystemExit(1 if bad else 0)


if __name__ == "__main__":
    main()
