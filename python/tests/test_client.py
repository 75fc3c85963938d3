"""The client against the daemon with its simulated bench, and against a server that behaves badly."""

import asyncio
import contextlib
import json
import os
import shutil
import socket
import subprocess
import threading
from pathlib import Path

import pytest
from conftest import ROOT

import eisbench as eb
from eisbench import _client

SERVE = """listen = "127.0.0.1:0"
data = "data"
configs = "."
benches = ["benches/demo.toml"]
"""


@pytest.fixture(scope="module")
def daemon(tmp_path_factory):
    """A daemon with the demo's bench; gives its address."""
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    binary = Path(os.environ.get("EIS_BENCH", target / "debug" / "eis-bench"))
    if not binary.exists():
        pytest.skip("needs target/debug/eis-bench, which `cargo build` makes")
    folder = tmp_path_factory.mktemp("daemon") / "configs"
    shutil.copytree(ROOT / "configs", folder)
    (folder / "own.toml").write_text(SERVE)
    process = subprocess.Popen(
        [binary, "serve", folder / "own.toml"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        yield process.stdout.readline().split()[-1]
    finally:
        process.terminate()
        process.wait(20)


@pytest.fixture(scope="module")
def finished(daemon):
    """A run of the demo that has ended."""
    client = eb.Client(daemon)
    job = client.submit("demo", seed=3)
    kinds = [event.kind for event in client.watch(job)]
    return client, job, kinds


def test_what_is_there(daemon):
    client = eb.Client(daemon)
    (bench,) = client.benches()
    assert bench["bench"] == "demo" and client.bench("demo")["instruments"]
    assert "demo" in client.experiments()


def test_a_run_from_submission_to_its_end(finished):
    client, job, kinds = finished
    assert kinds[0] == "hello" and "spectrum" in kinds
    assert client.wait(job).how == "finished"
    assert any(run.run == job.run and run.ended for run in client.runs())
    assert client.run(job)["now"]["points_done"] > 0
    assert client.queue() == []


def test_a_run_is_fetched_whole(finished, tmp_path):
    client, job, _ = finished
    run = client.fetch(job, tmp_path / "demo")
    assert run.spectra and run.models and run.captures
    with pytest.raises(eb.EisError, match="nothing is written over"):
        client.fetch(job, tmp_path / "demo")
    assert not (tmp_path / ".demo.partial").exists()


def test_a_watch_of_a_run_that_has_ended_ends(finished):
    client, job, _ = finished
    assert [event.kind for event in client.watch(job)][-1:] in ([], ["hello"], ["run"])


def test_an_experiment_as_text_waits_behind_a_hold_and_is_cancelled(daemon):
    client = eb.Client(daemon)
    client.hold("demo", "a test")
    try:
        text = (ROOT / "configs" / "experiments" / "demo.toml").read_text()
        job = client.submit(text=text, bench="demo")
        assert [waiting.run for waiting in client.queue()] == [job.run]
        client.cancel(job)
        assert client.queue() == []
    finally:
        client.release("demo")


def test_a_stop_tells_what_was_read(daemon):
    client = eb.Client(daemon)
    try:
        stopped = client.stop("demo")
        assert stopped["bench"] == "demo" and stopped["over"] and "verified" in stopped
        assert "demo" in client.held()
        assert client.stop_all()
    finally:
        client.release("demo")
    assert client.held() == {}


@pytest.mark.parametrize(
    ("work", "status"),
    [
        (lambda c: c.bench("none"), 404),
        (lambda c: c.run("none"), 404),
        (lambda c: c.submit("none"), None),
        (lambda c: c.submit(text="no = [toml"), None),
        (lambda c: c.stop("none"), 404),
        (lambda c: c.pause("none"), None),
    ],
    ids=["bench", "run", "experiment", "text", "stop", "pause"],
)
def test_refusals_have_status_code_and_message(daemon, work, status):
    with pytest.raises(eb.ApiError) as refused:
        work(eb.Client(daemon))
    error = refused.value
    assert 400 <= error.status < 500 and error.code and error.message
    assert status in (None, error.status)


def test_submit_wants_one_of_both(daemon):
    for words in ({}, {"experiment": "demo", "text": "x"}):
        with pytest.raises(eb.EisError, match="met both or neither"):
            eb.Client(daemon).submit(**words)


def test_the_same_for_asyncio(daemon):
    async def work():
        client = eb.AsyncClient(daemon)
        assert [bench["bench"] for bench in await client.benches()] == ["demo"]
        job = await client.submit("demo", seed=4)
        kinds = [event.kind async for event in client.watch(job)]
        assert "hello" in kinds
        return await client.wait(job)

    assert asyncio.run(work()).how == "finished"


def test_an_asynchronous_watch_can_be_left(daemon):
    async def work():
        async for event in eb.AsyncClient(daemon).watch():
            return event.kind

    assert asyncio.run(asyncio.wait_for(work(), 20)) == "hello"


# A server that behaves badly.


@contextlib.contextmanager
def serving(*answers):
    """A server that gives these answers, one to each connection, then none; gives its address and
    what it was asked."""
    listener = socket.create_server(("127.0.0.1", 0))
    asked = []

    def work():
        for answer in answers:
            try:
                peer, _ = listener.accept()
            except OSError:
                return
            with peer:
                peer.settimeout(5)
                head = b""
                with contextlib.suppress(OSError):
                    while b"\r\n\r\n" not in head:
                        head += peer.recv(65536) or b"\r\n\r\n"
                    asked.append(head.decode())
                    if callable(answer):
                        answer(peer)
                    else:
                        peer.sendall(answer)
        listener.close()

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}", asked
    finally:
        listener.close()


def answer(body, status="200 OK", more=""):
    body = body if isinstance(body, bytes) else json.dumps(body).encode()
    head = f"HTTP/1.1 {status}\r\nContent-Length: {len(body)}\r\n{more}\r\n"
    return head.encode() + body


STREAM = b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nConnection: close\r\n\r\n"


def event(number, kind="live", **data):
    return f"id: {number}\nevent: {kind}\ndata: {json.dumps(data)}\n\n".encode()


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(_client, "PAUSES_S", (0.01, 0.01, 0.01))


@pytest.mark.parametrize(
    "bad",
    [
        b"",
        b"HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\n[1, 2",
        b"this is not HTTP\r\n\r\n",
        answer(b"{half"),
    ],
    ids=["nothing", "cut", "no http", "no json"],
)
def test_answers_that_are_none(bad):
    with serving(bad) as (url, _), pytest.raises(eb.Unreachable):
        eb.Client(url, timeout_s=2).benches()
    with serving(bad) as (url, _), pytest.raises(eb.OutcomeUnknown):
        eb.Client(url, timeout_s=2).stop("demo")


def test_a_request_that_changes_something_is_sent_once():
    with serving(b"", b"", b"") as (url, asked):
        with pytest.raises(eb.OutcomeUnknown):
            eb.Client(url, timeout_s=2).submit("demo")
        assert len(asked) == 1 and asked[0].startswith("POST /api/v1/queue ")


def test_nobody_listens():
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(eb.Unreachable) as refused:
        eb.Client(f"http://127.0.0.1:{port}").stop("demo")
    assert not isinstance(refused.value, eb.OutcomeUnknown)


def test_a_server_that_hangs():
    with serving(lambda peer: threading.Event().wait(2)) as (url, _):
        with pytest.raises(eb.Unreachable):
            eb.Client(url, timeout_s=0.3).benches()


@pytest.mark.parametrize("status", ["301 Moved", "302 Found", "307 Temporary", "308 Permanent"])
def test_redirects_are_refused(status):
    moved = answer(b"", status, "Location: http://127.0.0.1:1/\r\n")
    with serving(moved) as (url, asked), pytest.raises(eb.Unreachable, match="a redirect"):
        eb.Client(url, "secret").benches()
    assert len(asked) == 1


@pytest.mark.parametrize(
    ("status", "code"),
    [("401 Unauthorized", "unauthorised"), ("409 Conflict", "held"), ("503 Busy", "busy")],
)
def test_refusals_of_each_kind(status, code):
    refusal = answer({"code": code, "message": "expected x, found y"}, status)
    with serving(refusal) as (url, _), pytest.raises(eb.ApiError, match="expected x") as refused:
        eb.Client(url).benches()
    assert (refused.value.status, refused.value.code) == (int(status[:3]), code)


def test_a_refusal_without_reason():
    with serving(answer(b"<html>", "500 No")) as (url, _):
        with pytest.raises(eb.ApiError, match="<html>"):
            eb.Client(url).benches()


def test_a_token_is_sent_and_never_shown():
    with serving(answer({"code": "x", "message": "y"}, "401 No")) as (url, asked):
        client = eb.Client(url, "a-secret")
        with pytest.raises(eb.ApiError) as refused:
            client.benches()
    assert "Authorization: Bearer a-secret" in asked[0]
    assert "a-secret" not in repr(client) + str(refused.value) + repr(eb.AsyncClient(url, "a-secret"))


def test_a_token_leaves_this_machine_over_tls_only():
    with pytest.raises(eb.EisError, match="expected https") as refused:
        eb.Client("http://192.0.2.1:7420", "a-secret")
    assert "a-secret" not in str(refused.value)


@pytest.mark.parametrize("url", ["127.0.0.1:80", "ftp://a", "http://", ""])
def test_addresses_that_are_none(url):
    with pytest.raises(eb.EisError, match="url: expected"):
        eb.Client(url)


@pytest.mark.parametrize("timeout_s", [0, -1, float("nan")])
def test_timeouts_that_are_none(timeout_s):
    with pytest.raises(eb.EisError, match="timeout_s"):
        eb.Client("http://127.0.0.1:1", timeout_s=timeout_s)


def test_a_watch_goes_on_behind_the_last_event():
    first = STREAM + event(1, "hello") + event(2, run="a") + b"id: 3\nevent: live\ndata: {\"ru"
    second = STREAM + event(3, run="b")
    with serving(first, second) as (url, asked):
        with pytest.raises(eb.Unreachable):
            seen = []
            for one in eb.Client(url).watch():
                seen.append(one.id)
        assert seen == ["1", "2", "3"]
        assert "Last-Event-ID" not in asked[0] and "Last-Event-ID: 2" in asked[1]


def test_a_watch_of_one_run_leaves_out_others():
    ended = {"job": {"item": {"id": 1, "run": "a", "experiment": "e", "bench": "b"},
                     "ended": {"how": "finished"}}}
    going = {"job": {**ended["job"], "ended": None}}
    stream = STREAM + event(1, "hello") + event(2, run="b") + event(3, run={"run": "a"})
    stream += event(4, "run", item={"run": "a"})
    with serving(stream, answer(going), answer(ended)) as (url, _):
        assert [one.id for one in eb.Client(url).watch("a")] == ["1", "3", "4"]


def test_events_with_comments_and_several_lines():
    stream = STREAM + b": a comment\n\nid: 7\r\ndata: {\"a\":\r\ndata: 1}\r\n\r\n"
    with serving(stream) as (url, _):
        watch = eb.Client(url).watch()
        one = next(watch)
        assert (one.id, one.kind, one.data) == ("7", "message", {"a": 1})
        watch.close()


def files(*entries):
    return [{"path": path, "bytes": len(body)} for path, body in entries]


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ([("a.csv", b"x")], "SHA256SUMS: expected the checksums"),
        ([("SHA256SUMS", b"0" * 64 + b"  a.csv\n"), ("a.csv", b"x")], "a.csv: expected SHA-256"),
        ([("SHA256SUMS", b"0" * 64 + b"  b.csv\n")], "b.csv: expected SHA-256 .* met no file"),
        ([("../../a", b"x")], "expected a file in the folder of the run"),
    ],
    ids=["no sums", "other bytes", "missing", "beyond"],
)
def test_what_is_fetched_is_held_against_its_sums(tmp_path, entries, message):
    bodies = [answer(body) for _, body in entries]
    with serving(answer(files(*entries)), *bodies) as (url, _):
        with pytest.raises(eb.EisError, match=message):
            eb.Client(url).fetch("r", tmp_path / "r")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_cut_is_told(tmp_path):
    short = answer([{"path": "a.csv", "bytes": 10}])
    with serving(short, answer(b"12345")) as (url, _):
        with pytest.raises(eb.Unreachable, match="expected 10 bytes, met 5"):
            eb.Client(url).fetch("r", tmp_path / "r")
    assert list(tmp_path.iterdir()) == []


def test_names_are_quoted():
    with serving(answer({})) as (url, asked):
        eb.Client(url).bench("a/b ?")
    assert asked[0].startswith("GET /api/v1/benches/a%2Fb%20%3F ")
