"""A proxy before an HTTP server that fails: 500, 503, connections that are reset in the middle of a
request or of an answer, answers that end early, answers that never come, and wrong bytes."""

import asyncio
import collections
import random
import socket
import struct

FAULTS = ["500", "503", "reset-request", "reset-answer", "short-answer", "lost-answer", "stall", "wrong"]
# The client waits longer, and is to try again when the connection breaks.
STALL_S = 2.0


class Proxy:
    """Passes requests on, and fails with a share of them."""

    def __init__(self, port: int, share: float, seed: int) -> None:
        self.port, self.share, self.dice = port, share, random.Random(seed)
        self.requests = 0
        self.faults: collections.Counter[str] = collections.Counter()
        self.address = 0

    async def start(self) -> None:
        """Listens on a free port."""
        server = await asyncio.start_server(self.serve, "127.0.0.1", 0, limit=1 << 20)
        self.address = server.sockets[0].getsockname()[1]

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serves one connection."""
        back = None
        try:
            back = await asyncio.open_connection("127.0.0.1", self.port, limit=1 << 20)
            while await self.one(reader, writer, *back):
                pass
        except (OSError, asyncio.IncompleteReadError):
            pass
        finally:
            for end in (writer, *(back or ())[1:]):
                end.close()

    async def one(self, reader, writer, back_reader, back_writer) -> bool:
        """Passes one request on; whether the connection goes on."""
        head = await reader.readuntil(b"\r\n\r\n")
        self.requests += 1
        length = body_length(head)
        fault = self.dice.choice(FAULTS) if self.dice.random() < self.share else None
        is_read = head.startswith(b"GET ") and b"/objects/" in head.split(b"\r\n", 1)[0]
        if fault == "wrong" and not is_read:
            fault = "503"
        if fault:
            self.faults[fault] += 1
        if fault == "reset-request":
            await reader.readexactly(length // 2)
            return reset(writer)
        body = await reader.readexactly(length)
        if fault in ("500", "503"):
            words = {"500": b"Internal Server Error", "503": b"Slow Down"}[fault]
            writer.write(b"HTTP/1.1 " + fault.encode() + b" " + words + b"\r\nContent-Length: 0\r\n\r\n")
            await writer.drain()
            return True
        if fault == "stall":
            await asyncio.sleep(STALL_S)
            return reset(writer)
        back_writer.write(head + body)
        await back_writer.drain()
        answer = b"HTTP/1.1 100"
        while answer.startswith(b"HTTP/1.1 100"):
            answer = await back_reader.readuntil(b"\r\n\r\n")
        is_bare = head.startswith(b"HEAD ") or answer.split(b" ", 2)[1] in (b"204", b"304")
        content = await back_reader.readexactly(0 if is_bare else body_length(answer))
        if fault == "lost-answer":
            return reset(writer)
        if fault in ("short-answer", "reset-answer"):
            writer.write(answer + content[: len(content) // 2])
            await writer.drain()
            return reset(writer) if fault == "reset-answer" else False
        if fault == "wrong" and content:
            place = self.dice.randrange(len(content))
            content = content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]
        writer.write(answer + content)
        await writer.drain()
        return b"connection: close" not in answer.lower()


def body_length(head: bytes) -> int:
    """Length of the body behind a head."""
    for line in head.lower().split(b"\r\n"):
        if line.startswith(b"content-length:"):
            return int(line.split(b":")[1])
    return 0


def reset(writer: asyncio.StreamWriter) -> bool:
    """Ends a connection with a reset."""
    linger = struct.pack("ii", 1, 0)
    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
    return False
