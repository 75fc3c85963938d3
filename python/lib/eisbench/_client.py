"""A client of the daemon ``eis-bench serve`` (``docs/serve.md``). The standard library speaks HTTP."""

from __future__ import annotations

import asyncio
import hashlib
import http.client
import json
import os
import shutil
import ssl
import time
import urllib.parse
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Optional, Union, cast

from ._eisbench import EisError
from ._series import Run

PathLike = Union[str, "os.PathLike[str]"]

# Maximum length of an answer of the daemon, bytes; files are read in pieces.
MOST_BYTES = 64 << 20
# Pauses between attempts to listen again, s: in all about as long as a restart of the daemon takes.
PAUSES_S = (0.5, 1.0, 2.0, 4.0, 8.0)
# The daemon sends something at least every 15 s.
SILENCE_S = 45.0


class ApiError(EisError):
    """The daemon has refused a request: ``status``, ``code`` and ``message`` are its own."""

    def __init__(self, status: int, code: str, message: str) -> None:
        super().__init__(f"{status} {code}: {message}")
        self.status = status
        self.code = code
        self.message = message


class Unreachable(EisError, ConnectionError):
    """The daemon cannot be reached, or the connection was lost."""


class OutcomeUnknown(Unreachable):
    """The connection was lost after a request was sent that changes something. It may have been
    done: look at ``queue()`` and ``runs()`` before it is sent again."""


@dataclass(frozen=True)
class Event:
    """Something that changed: ``kind`` is ``hello``, ``live``, ``spectrum``, ``run``, ``queue``,
    ``stop`` or ``lost``; ``data`` is the daemon's description of it."""

    id: str
    kind: str
    data: dict[str, Any] = field(repr=False)


@dataclass(frozen=True)
class Job:
    """An experiment in the queue, or a run."""

    id: int
    run: str
    experiment: str
    bench: str
    how: Optional[str]
    raw: dict[str, Any] = field(repr=False)

    @property
    def ended(self) -> bool:
        """Whether it has come to an end; ``how`` says which."""
        return self.how is not None


def _job(record: dict[str, Any]) -> Job:
    item: dict[str, Any] = record.get("item", record)
    end: Optional[dict[str, Any]] = record.get("ended")
    how = None if end is None else str(end["how"])
    return Job(int(item["id"]), item["run"], item["experiment"], item["bench"], how, record)


class Client:
    """A client of one daemon: ``Client("http://127.0.0.1:7420", token="…")``.

    ``ca`` is a file of certificates that the daemon's is held against. Every request ends within
    ``timeout_s``. A token is sent over TLS or to this machine only, and shown nowhere.

    Requests that change something are sent once: where the answer is lost,
    :class:`OutcomeUnknown` is raised. Redirects are refused.
    """

    def __init__(
        self,
        url: str,
        token: Optional[str] = None,
        *,
        ca: Optional[PathLike] = None,
        timeout_s: float = 30.0,
    ) -> None:
        parts = urllib.parse.urlsplit(url)
        if parts.scheme not in ("http", "https") or parts.hostname is None:
            raise EisError(f"url: expected http://host:port or https://host:port, met {url!r}")
        local = parts.hostname in ("127.0.0.1", "localhost", "::1")
        if token is not None and parts.scheme == "http" and not local:
            raise EisError("url: expected https for a token that leaves this machine, met http")
        if not timeout_s > 0:
            raise EisError(f"timeout_s: expected a time above 0 s, met {timeout_s}")
        self._host = parts.hostname
        self._port = parts.port
        self._prefix = parts.path.rstrip("/")
        self._tls = ssl.create_default_context(cafile=ca) if parts.scheme == "https" else None
        self._token = token
        self._timeout_s = timeout_s

    def __repr__(self) -> str:
        return f"<Client of {self._host}:{self._port}>"

    # What can be seen

    def benches(self) -> list[dict[str, Any]]:
        """Each bench as it is now."""
        return self._json("GET", "/benches")

    def bench(self, bench: str) -> dict[str, Any]:
        """One bench as it is now: state, run, reading, limits, instruments, trip, last stop."""
        return self._json("GET", f"/benches/{_name(bench)}")

    def experiments(self) -> list[str]:
        """Names of the experiments that can be submitted."""
        return [str(entry["experiment"]) for entry in self._json("GET", "/experiments")]

    def queue(self) -> list[Job]:
        """What waits, in its order."""
        return [_job(item) for item in self._json("GET", "/queue")["items"]]

    def held(self) -> dict[str, Any]:
        """Benches on which nothing begins until :meth:`release`, and why."""
        return self._json("GET", "/queue")["held"]

    def runs(self) -> list[Job]:
        """Runs that go on or have ended."""
        return [_job(record) for record in self._json("GET", "/runs")]

    def run(self, run: Union[str, Job]) -> dict[str, Any]:
        """One run: ``job``, ``now`` (step, points done, time left), ``resumable``."""
        return self._json("GET", f"/runs/{_run(run)}")

    # What changes something

    def submit(
        self,
        experiment: Optional[str] = None,
        *,
        text: Optional[str] = None,
        bench: Optional[str] = None,
        seed: Optional[int] = None,
    ) -> Job:
        """Puts an experiment of the daemon, or the ``text`` of one (TOML), into the queue."""
        if (experiment is None) == (text is None):
            raise EisError("submit: expected one of experiment and text, met both or neither")
        fields = {"experiment": experiment, "text": text, "bench": bench, "seed": seed}
        body = {name: value for name, value in fields.items() if value is not None}
        return _job(self._json("POST", "/queue", body))

    def cancel(self, job: Job) -> None:
        """Takes an experiment that waits out of the queue."""
        self._json("DELETE", f"/queue/{job.id}")

    def stop(self, bench: str) -> dict[str, Any]:
        """Ends what runs on a bench in safe state, switches it off and reads it back; ``verified``
        of the answer says whether every output has said itself that it is off."""
        return self._json("POST", f"/benches/{_name(bench)}/stop")

    def stop_all(self) -> Any:
        """Stops every bench; the answer has a report for each."""
        return self._json("POST", "/stop")

    def hold(self, bench: str, why: str = "") -> None:
        """Lets nothing begin on a bench until :meth:`release`."""
        self._json("POST", f"/benches/{_name(bench)}/hold", {"why": why})

    def release(self, bench: str) -> None:
        """Lets the queue of a bench go on."""
        self._json("POST", f"/benches/{_name(bench)}/release")

    def pause(self, run: Union[str, Job]) -> None:
        """Lets a run wait after the point in work."""
        self._json("POST", f"/runs/{_run(run)}/pause")

    def go_on(self, run: Union[str, Job]) -> None:
        """Lets a run that was paused go on."""
        self._json("POST", f"/runs/{_run(run)}/go-on")

    def resume(self, run: Union[str, Job]) -> Job:
        """Puts a run that was interrupted back into the queue."""
        return _job(self._json("POST", f"/runs/{_run(run)}/resume"))

    # What takes longer

    def watch(self, run: Union[str, Job, None] = None) -> Iterator[Event]:
        """Events as they happen, of one run until it has ended, or of everything without end.

        A connection that is lost is taken up again behind the last event; Unreachable is raised
        after several attempts in vain. ``lost`` says that events were missed.
        """
        wanted = None if run is None else _run(run)
        last, failures = "", 0
        while True:
            try:
                for event in self._events(last):
                    last, failures = event.id or last, 0
                    if wanted is None or _concerns(event, wanted):
                        yield event
                    # A run may have ended before the first event.
                    after = event.kind in ("hello", "run", "lost")
                    if wanted is not None and after and self._has_ended(wanted):
                        return
                raise Unreachable("the stream of events has ended")
            except Unreachable:
                if failures == len(PAUSES_S):
                    raise
                time.sleep(PAUSES_S[failures])
                failures += 1

    def wait(self, run: Union[str, Job]) -> Job:
        """Waits until a run has ended."""
        for _ in self.watch(run):
            pass
        return _job(self.run(run)["job"])

    def fetch(self, run: Union[str, Job], folder: PathLike) -> Run:
        """Downloads the folder of a run, holds every file against ``SHA256SUMS`` of the run, and
        puts the whole into place at the end. Nothing that is there is written over."""
        name, into = _run(run), Path(folder)
        if into.exists():
            raise EisError(f"{into}: expected nothing, met something; nothing is written over")
        partial = into.with_name(f".{into.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        try:
            for entry in self._json("GET", f"/runs/{name}/files"):
                self._file(name, str(entry["path"]), int(entry["bytes"]), partial)
            _check_sums(partial)
            partial.rename(into)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
        return Run(into)

    def fetch_file(self, run: Union[str, Job], path: str, folder: PathLike) -> Path:
        """Downloads one file of a run into a folder, at its place in the run."""
        return self._file(_run(run), path, None, Path(folder))

    # The protocol

    def _has_ended(self, run: str) -> bool:
        try:
            job = self._json("GET", f"/runs/{run}")["job"]
            # For a moment between queue and run, neither lists the job.
            return job is not None and _job(job).ended
        except ApiError as error:
            if error.status == 404:
                return False
            raise

    def _connection(self, timeout_s: float) -> http.client.HTTPConnection:
        if self._tls is None:
            return http.client.HTTPConnection(self._host, self._port, timeout=timeout_s)
        return http.client.HTTPSConnection(
            self._host, self._port, timeout=timeout_s, context=self._tls
        )

    def _open(
        self, method: str, path: str, body: Any, more: dict[str, str], timeout_s: float
    ) -> tuple[http.client.HTTPConnection, http.client.HTTPResponse]:
        """Sends a request; the answer is one of success."""
        headers = {"Accept": "application/json", **more}
        if self._token is not None:
            headers["Authorization"] = f"Bearer {self._token}"
        data = None
        if body is not None:
            data, headers["Content-Type"] = json.dumps(body).encode(), "application/json"
        connection, sent = self._connection(timeout_s), False
        try:
            connection.connect()
            sent = True
            connection.request(method, f"{self._prefix}/api/v1{path}", data, headers)
            answer = connection.getresponse()
            if 200 <= answer.status < 300:
                return connection, answer
            reply = answer.read(MOST_BYTES)
        except (OSError, http.client.HTTPException) as error:
            connection.close()
            unknown = sent and method != "GET"
            kind = OutcomeUnknown if unknown else Unreachable
            raise kind(f"{self._host}:{self._port}: {method} {path}: {error!r}") from None
        except BaseException:
            connection.close()
            raise
        connection.close()
        raise _refusal(answer.status, reply)

    def _json(self, method: str, path: str, body: Any = None) -> Any:
        connection, answer = self._open(method, path, body, {}, self._timeout_s)
        try:
            reply = answer.read(MOST_BYTES + 1)
            if len(reply) > MOST_BYTES:
                raise Unreachable(f"{path}: expected at most {MOST_BYTES} bytes, met more")
            return json.loads(reply) if reply.strip() else None
        except (OSError, http.client.HTTPException, ValueError) as error:
            if isinstance(error, EisError):
                raise
            kind = Unreachable if method == "GET" else OutcomeUnknown
            raise kind(f"{path}: expected a whole answer: {error!r}") from None
        finally:
            connection.close()

    def _events(self, last: str) -> Iterator[Event]:
        more = {"Accept": "text/event-stream"}
        if last:
            more["Last-Event-ID"] = last
        connection, answer = self._open("GET", "/events", None, more, SILENCE_S)
        try:
            lines: list[str] = []
            while True:
                line = answer.readline(MOST_BYTES)
                # Half a line is not an event: the connection was lost within it.
                if not line.endswith(b"\n"):
                    return
                text = line.decode("utf-8").rstrip("\r\n")
                if text:
                    lines.append(text)
                    continue
                event = _event(lines)
                lines = []
                if event is not None:
                    yield event
        except (OSError, http.client.HTTPException, ValueError) as error:
            if isinstance(error, EisError):
                raise
            raise Unreachable(f"events: {error!r}") from None
        finally:
            connection.close()

    def _file(self, run: str, path: str, size: Optional[int], folder: Path) -> Path:
        into = (folder / path).resolve()
        if not into.is_relative_to(folder.resolve()):
            raise EisError(f"{path}: expected a file in the folder of the run, met one beyond it")
        into.parent.mkdir(parents=True, exist_ok=True)
        quoted = urllib.parse.quote(path)
        connection, answer = self._open(
            "GET", f"/runs/{run}/files/{quoted}", None, {"Accept": "*/*"}, self._timeout_s
        )
        length = answer.headers.get("Content-Length")
        try:
            with into.open("wb") as file:
                shutil.copyfileobj(cast(Any, answer), file, 1 << 20)
        except (OSError, http.client.HTTPException) as error:
            raise Unreachable(f"{path}: {error!r}") from None
        finally:
            connection.close()
        met, expected = into.stat().st_size, int(length) if size is None and length else size
        if expected is not None and met != expected:
            raise Unreachable(f"{path}: expected {expected} bytes, met {met}")
        return into


def _refusal(status: int, reply: bytes) -> EisError:
    if 300 <= status < 400:
        return Unreachable(f"expected an answer of the daemon, met a redirect ({status})")
    try:
        problem: dict[str, Any] = json.loads(reply)
        return ApiError(status, str(problem["code"]), str(problem["message"]))
    except (ValueError, KeyError, TypeError):
        text = reply[:200].decode("utf-8", "replace")
        return ApiError(status, "unknown", text or "no reason was given")


def _event(lines: list[str]) -> Optional[Event]:
    fields = {"id": "", "event": "message", "data": ""}
    for line in lines:
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if name == "data" and fields["data"]:
            value = f"{fields['data']}\n{value}"
        if name in fields:
            fields[name] = value
    if not fields["data"]:
        return None
    return Event(fields["id"], fields["event"], json.loads(fields["data"]))


def _concerns(event: Event, run: str) -> bool:
    """Whether an event concerns a run. An event without a run concerns every run."""
    # The event of a new scan of the catalogue has `null` as its data.
    data: Any = event.data
    if data is None:
        return False
    item: Any = data.get("item") or data.get("run")
    of: Any = cast("dict[str, Any]", item).get("run") if isinstance(item, dict) else item
    return of is None or of == run


def _check_sums(folder: Path) -> None:
    sums = folder / "SHA256SUMS"
    if not sums.is_file():
        raise EisError("SHA256SUMS: expected the checksums of the run, met none")
    for line in sums.read_text(encoding="utf-8").splitlines():
        expected, _, name = line.partition("  ")
        file = folder / name
        met = hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else "no file"
        if met != expected:
            raise EisError(f"{name}: expected SHA-256 {expected}, met {met}")


def _name(name: str) -> str:
    return urllib.parse.quote(name, safe="")


def _run(run: Union[str, Job]) -> str:
    return _name(run.run if isinstance(run, Job) else run)


class AsyncClient:
    """The same for asyncio: every method of :class:`Client` as a coroutine, in a thread of its own;
    ``watch`` is an asynchronous iterator. A task that is cancelled leaves a request to its end."""

    def __init__(self, url: str, token: Optional[str] = None, **options: Any) -> None:
        self._client = Client(url, token, **options)

    def __repr__(self) -> str:
        return f"<Async{repr(self._client)[1:]}"

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        work = getattr(self._client, name)

        async def apart(*words: Any, **named: Any) -> Any:
            return await asyncio.to_thread(work, *words, **named)

        return apart

    async def watch(self, run: Union[str, Job, None] = None) -> AsyncIterator[Event]:
        """Events as they happen, as :meth:`Client.watch`."""
        events = self._client.watch(run)
        try:
            while True:
                event = await asyncio.to_thread(next, events, None)
                if event is None:
                    return
                yield event
        finally:
            # A thread that still waits for an event holds the iterator until the next one.
            close: Any = getattr(events, "close", None)
            try:
                close()
            except ValueError:
                pass
