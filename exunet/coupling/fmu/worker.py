"""The process beside an instance of an FMU: takes one request after the other from its socket.

A request is a header (two whole numbers of 8 bytes: what is asked, length) and its content; a reply a header
(status, length) and its content, which is the text of the error where the status is not zero. Numbers are in
the order of bytes of the machine, floating-point numbers of 8 bytes. `exunet/coupling/fmu/c/worker.c` is the
other side.
"""

from __future__ import annotations

import os
import signal
import socket
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from exunet.base.errors import ExunetError, RunStopped
from exunet.coupling.fmu.served import Served, StepDiscarded

HEADER = struct.Struct("=QQ")
DONE, FAILED, STOPPED = 0, 1, 2
_NUMBER = struct.Struct("=Q")
_STEP = struct.Struct("=dd")


def _floats(content: bytes) -> np.ndarray:
    return np.frombuffer(content, dtype=np.float64).copy()


def _build(served: Served, content: bytes) -> bytes:
    return served.build(_floats(content)).tobytes()


def _step(served: Served, content: bytes) -> bytes:
    begin, end = _STEP.unpack_from(content)
    return served.step(begin, end, _floats(content[_STEP.size :])).tobytes()


def _keep(served: Served, _content: bytes) -> bytes:
    return _NUMBER.pack(served.keep())


def _restore(served: Served, content: bytes) -> bytes:
    served.restore(*_NUMBER.unpack(content))
    return b""


def _free(served: Served, content: bytes) -> bytes:
    served.free(*_NUMBER.unpack(content))
    return b""


def _pack(served: Served, content: bytes) -> bytes:
    (number,) = _NUMBER.unpack_from(content)
    return served.pack(number, _floats(content[_NUMBER.size :]))


def _unpack(served: Served, content: bytes) -> bytes:
    (size,) = _NUMBER.unpack_from(content)
    number, values = served.unpack(content[_NUMBER.size :], size)
    return _NUMBER.pack(number) + values.tobytes()


_ANSWERS: tuple[Callable[[Served, bytes], bytes], ...] = (
    _build,
    _step,
    _keep,
    _restore,
    _free,
    _pack,
    _unpack,
)


def serve(connection: socket.socket, folder: Path) -> None:
    """Answer the requests that come over a socket until the other side closes it."""
    try:
        served = Served(folder)
    except ExunetError as error:
        _reply(connection, FAILED, str(error).encode())
        return
    _reply(connection, DONE, served.content.token.encode())
    while header := _receive(connection, HEADER.size):
        what, length = HEADER.unpack(header)
        content = _receive(connection, length)
        if len(content) < length:
            return
        _reply(connection, *_answer(served, what, content))


def _answer(served: Served, what: int, content: bytes) -> tuple[int, bytes]:
    try:
        return DONE, _ANSWERS[what](served, content)
    except (RunStopped, StepDiscarded) as stop:
        return STOPPED, str(stop).encode()
    except ExunetError as error:
        return FAILED, str(error).encode()
    except Exception as error:  # noqa: BLE001 - the host gets the words of every fault, and stops the instance
        return FAILED, f"a defect of exunet: {type(error).__name__}: {error}".encode()


def _reply(connection: socket.socket, status: int, content: bytes) -> None:
    connection.sendall(HEADER.pack(status, len(content)) + content)


def _receive(connection: socket.socket, length: int) -> bytes:
    """So many bytes; fewer if the other side has closed."""
    found = bytearray()
    while len(found) < length and (part := connection.recv(min(length - len(found), 1 << 20))):
        found += part
    return bytes(found)


def main(folder: str) -> None:
    """Serve over the socket that standard input is, and end the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the host ends its workers
    connection = socket.socket(fileno=os.dup(0))
    with suppress(OSError):  # the host has gone
        serve(connection, Path(folder))
    os._exit(0)  # nothing is to be written any more, and a host waits
