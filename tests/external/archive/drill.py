"""The drill of the archive: runs go up through a proxy that fails, processes are killed, and what is in
the store is compared byte by byte by a reader that is not ours.

Usage: drill.py EIS_BENCH ROOT RUNS KILLS
"""

import asyncio
import collections
import hashlib
import json
import os
import random
import shutil
import socket
import sys
import tempfile
import time
from pathlib import Path

import boto3

import made
import readers
from proxy import Proxy

BUCKET, PREFIX = "lab", "eis"
SHARE = 0.03
KEYS = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"}


class Drill:
    """A place with runs, a store and a proxy before it."""

    def __init__(self, program: str, root: Path, folder: Path, count: int) -> None:
        self.program, self.root, self.folder, self.count = program, root, folder, count
        self.data, self.config = folder / "data", folder / "serve.toml"
        self.cpu_s = self.took_s = 0.0
        self.killed = 0
        self.table: list[tuple[str, object]] = []

    def configure(self, port: int) -> None:
        """Writes the server's file."""
        self.config.write_text(
            f'listen = "127.0.0.1:0"\ndata = "data"\nconfigs = "{self.root}/configs"\n'
            f'benches = ["{self.root}/configs/benches/demo.toml"]\n'
            f'[archive]\nstore = "s3://{BUCKET}/{PREFIX}"\nsite = "north hall"\n'
            f'endpoint = "http://127.0.0.1:{port}"\n'
        )

    async def archive(self, act: str, *arguments: str, kill_after_s: float | None = None):
        """Runs `eis-bench archive`; its exit code and what it printed."""
        began = time.monotonic()
        process = await asyncio.create_subprocess_exec(
            self.program, "archive", act, str(self.config), *arguments,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, env=os.environ | KEYS,
        )
        before = os.times()
        talking = asyncio.create_task(process.communicate())
        if kill_after_s is not None:
            done, _ = await asyncio.wait([talking], timeout=kill_after_s)
            if not done:
                process.kill()
                self.killed += 1
        out, errors = await talking
        after = os.times()
        self.cpu_s += after.children_user - before.children_user
        self.cpu_s += after.children_system - before.children_system
        self.took_s += time.monotonic() - began
        return process.returncode, out.decode(), errors.decode()

    async def push_at_last(self) -> dict:
        """Pushes until nothing is left to do."""
        for _ in range(20):
            code, out, errors = await self.archive("push", "--json", "--tries", "8")
            if code == 0:
                return json.loads(out)
            print(f"push ended with {code}: {errors.strip().splitlines()[-1:]}")
        raise SystemExit("the push did not come to its end")

    def tell(self, what: str, value: object) -> None:
        """Adds a line to the table."""
        self.table.append((what, value))
        print(f"{what}: {value}", flush=True)


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def sources(data: Path) -> dict[str, dict[str, bytes]]:
    """Files of each run as they must be in the store, by run and path."""
    runs: dict[str, dict[str, bytes]] = {}
    for folder in sorted((data / "runs").iterdir()):
        paths = [path for path in folder.rglob("*") if path.is_file()]
        runs[folder.name] = {str(path.relative_to(folder)): path.read_bytes() for path in paths}
    for file in sorted((data / "analyses").rglob("diagnosis.json")):
        text = file.read_bytes()
        runs[json.loads(text)["data_set"]][str(file.relative_to(data))] = text
    return runs


def compare(client, data: Path) -> dict[str, int]:
    """Compares every byte of the store with the sources; what differs ends the drill."""
    held = {}
    for page in client.get_paginator("list_objects_v2").paginate(Bucket=BUCKET):
        for entry in page.get("Contents", []):
            held[entry["Key"].removeprefix(f"{PREFIX}/")] = entry["Size"]
    read = lambda key: client.get_object(Bucket=BUCKET, Key=f"{PREFIX}/{key}")["Body"].read()  # noqa: E731
    found = collections.Counter()
    seen = set()
    for name, files in sources(data).items():
        hashes = {path: hashlib.sha256(text).hexdigest() for path, text in files.items()}
        lines = "".join(sorted(f"{hash_}  {path}\n" for path, hash_ in hashes.items()))
        run = hashlib.sha256(lines.encode()).hexdigest()
        listed = json.loads(read(f"runs/{run}.json"))
        assert listed["name"] == name and listed["site"] == "north hall", name
        wanted = [
            {"path": path, "sha256": hashes[path], "bytes": len(files[path])} for path in sorted(files)
        ]
        assert listed["files"] == wanted, name
        for path, text in files.items():
            key = f"objects/sha256/{hashes[path][:2]}/{hashes[path]}"
            assert held[key] == len(text), (name, path)
            if key not in seen:
                assert read(key) == text, (name, path)
                seen.add(key)
                found["objects"] += 1
                found["object_bytes"] += len(text)
            found["files"] += 1
            found["bytes"] += len(text)
        found["runs"] += 1
    found["lists"] = sum(key.startswith("runs/") for key in held)
    found["unknown"] = sum(key.startswith("objects/") and key not in seen for key in held)
    return found


def mirror(client, folder: Path) -> Path:
    """Copies the tables into a folder."""
    shutil.rmtree(folder, ignore_errors=True)
    for page in client.get_paginator("list_objects_v2").paginate(Bucket=BUCKET, Prefix=f"{PREFIX}/tables/"):
        for entry in page.get("Contents", []):
            target = folder / entry["Key"].removeprefix(f"{PREFIX}/tables/")
            target.parent.mkdir(parents=True, exist_ok=True)
            client.download_file(BUCKET, entry["Key"], str(target))
    return folder


async def started(folder: Path) -> tuple[asyncio.subprocess.Process, int]:
    """The S3-compatible server, and its port."""
    port = free_port()
    log = (folder / "moto.log").open("w")
    server = await asyncio.create_subprocess_exec(
        str(Path(sys.executable).with_name("moto_server")), "-H", "127.0.0.1", "-p", str(port),
        stdout=log, stderr=log,
    )
    for _ in range(600):
        try:
            _, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.close()
            return server, port
        except OSError:
            await asyncio.sleep(0.1)
    raise SystemExit("moto does not listen")


async def drill(self: Drill, kills: int) -> None:
    """Plays the drill."""
    made.write(self.data / "runs", self.count)
    server, port = await started(self.folder)
    client = boto3.client(
        "s3", endpoint_url=f"http://127.0.0.1:{port}", aws_access_key_id="test",
        aws_secret_access_key="test", region_name="us-east-1",
    )
    aside = lambda *work: asyncio.get_running_loop().run_in_executor(None, *work)  # noqa: E731
    try:
        client.create_bucket(Bucket=BUCKET)
        proxy = Proxy(port, SHARE, 1)
        await proxy.start()
        self.configure(proxy.address)
        dice = random.Random(2)
        while self.killed < kills:
            code, _, _ = await self.archive("push", "--tries", "8", kill_after_s=dice.uniform(0.3, 6.0))
            if code == 0:
                break
        await self.push_at_last()
        self.tell("runs", self.count)
        self.tell("processes killed", self.killed)
        self.tell("requests, and faults among them", f"{proxy.requests}, {sum(proxy.faults.values())}")
        self.tell("faults by kind", dict(proxy.faults))
        found = await aside(compare, client, self.data)
        self.tell("files compared, and their bytes", f"{found['files']}, {found['bytes']}")
        self.tell("objects compared, and their bytes", f"{found['objects']}, {found['object_bytes']}")
        assert found["runs"] == found["lists"] == self.count and not found["unknown"], found
        self.tell("time of the pushes, s", f"{self.took_s:.0f}")
        self.tell("processor time of the pushes, s", f"{self.cpu_s:.1f}")
        before = proxy.requests
        code, out, _ = await self.archive("push", "--json")
        assert code == 0 and json.loads(out)["unchanged"] == self.count, out
        assert proxy.requests == before, "a push without a change asked the store"
        # A diagnosis makes each of some runs another one; the push of that is killed, too.
        some = range(0, self.count, 20)
        for number in some:
            made.diagnose(self.data, number)
        await self.archive("push", "--tries", "8", kill_after_s=1.5)
        await self.push_at_last()
        found = await aside(compare, client, self.data)
        assert found["runs"] == self.count and found["lists"] == self.count + len(some), found
        self.tell("runs with a new diagnosis", len(some))
        tables = await aside(mirror, client, self.folder / "tables")
        by = await aside(readers.figures, tables)
        wanted = {"runs": self.count, "spectra": self.count * made.POINTS, "fits": 2 * self.count,
                  "diagnoses": len(some)}
        for program, read in by.items():
            rows = {name: figures[0] for name, figures in read.items()}
            assert rows == wanted, (program, rows, wanted)
            assert read == by["duckdb"], (program, read, by["duckdb"])
            assert read["runs"][1] == self.count, read
        self.tell("tables read alike by", ", ".join(by))
        self.tell("rows", wanted)
        await moved(self)
        proxy.share = 0.0
        code, out, errors = await self.archive("verify", "--json")
        verified = json.loads(out)
        assert code == 0 and verified["runs"] == self.count and not verified["wrong"], errors
        self.tell("files read back by `archive verify`", verified["files"])
    finally:
        server.kill()
        await server.wait()
    print("\n| | |\n|---|---|")
    for what, value in self.table:
        print(f"| {what} | {value} |")


async def moved(self: Drill) -> None:
    """Captures are moved away, killed in the middle, and brought back as they were."""
    captures = {path: path.read_bytes() for path in (self.data / "runs").glob("run00000?/captures/*/*")}
    runs = [f"run00000{k}" for k in range(10) if k < self.count]
    await self.archive("thin", *runs, "--captures-after", "0 s", kill_after_s=0.4)
    for _ in range(40):
        code, _, _ = await self.archive("thin", *runs, "--captures-after", "0 s")
        if code == 0:
            break
    assert not any(path.exists() for path in captures)
    for run in runs:
        for _ in range(40):
            code, _, _ = await self.archive("fetch", run)
            if code == 0:
                break
    assert all(path.read_bytes() == text for path, text in captures.items())
    self.tell("captures moved away and brought back", len(captures))


if __name__ == "__main__":
    program_, root_, count_, kills_ = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder_:
        place = Drill(str(Path(program_).resolve()), Path(root_), Path(folder_), int(count_))
        asyncio.run(drill(place, int(kills_)))
