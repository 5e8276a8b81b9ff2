"""The way to workers: addresses, clients, and whether those who answer can do the work."""

from __future__ import annotations

import contextlib
import os
import platform
import socket
from collections.abc import Callable, Iterator
from concurrent import futures
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import FileError, NrsfmError, OptionError

CONNECTING = 5.0
"""Seconds until an address that does not answer is given up."""

WAITING = 30.0
"""Seconds without any worker until a run is given up."""


class ClusterError(NrsfmError, RuntimeError):
    """A cluster cannot be reached, has no workers, or its workers cannot do what they are asked for."""


class Address(str):
    """Where a cluster is, with the client or executor that the caller gave; a plain word to all who only record it."""

    given: Any

    def __new__(cls, address: str, given: Any = None) -> Address:
        """An address, and the object whose it is."""
        found = super().__new__(cls, address)
        found.given = given
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        return str, (str(self),)


def addressed(value: Any) -> Any:
    """The option ``cluster`` as a word: an address, the address of a client, or the kind of an executor.

    Raises ``OptionError`` for anything else, and for a client that is closed.
    """
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, futures.Executor):
        return Address(f"executor:{type(value).__name__}", value)
    if type(value).__module__.partition(".")[0] == "distributed" and hasattr(value, "scheduler"):
        if getattr(value, "asynchronous", False):
            raise OptionError("option 'cluster': an asynchronous client cannot be used; give its address")
        if value.status != "running" or value.scheduler is None:
            raise OptionError(f"option 'cluster': the client must be running, received one that is {value.status}")
        return Address(value.scheduler.address, value)
    raise OptionError(
        "option 'cluster' must be an address such as tcp://host:8786, a dask.distributed Client or a "
        f"concurrent.futures.Executor, received {type(value).__name__}"
    )


@contextlib.contextmanager
def connected(cluster: str) -> Iterator[Any]:
    """A client of a cluster that has workers like this process: the caller's own, or one that is closed at the end."""
    given = getattr(cluster, "given", None)
    if given is not None:
        _require_workers(given)
        yield given
        return
    distributed = import_distributed()
    try:
        _knock(str(cluster))
        client = distributed.Client(str(cluster), timeout=CONNECTING, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:  # a timeout is an OSError
        raise ClusterError(
            f"cluster: no scheduler answers at '{cluster}' within {CONNECTING:g} s (is it a dask scheduler's address, "
            "such as tcp://host:8786?)"
        ) from error
    try:
        _require_workers(client)
        yield client
    finally:
        client.close()


def _knock(address: str) -> None:
    """Raise ``OSError`` or ``ValueError`` where nobody listens, or nobody can, at the address of a scheduler.

    A client that fails to connect leaves threads behind, and is taken down at a bad time when it is collected.
    """
    from distributed.comm.addressing import get_address_host_port

    place: tuple[str, int] = get_address_host_port(address)
    socket.create_connection(place, timeout=CONNECTING).close()


def import_distributed() -> Any:
    """Return dask's ``distributed``. Raises ``OptionError`` where it is not installed."""
    try:
        import distributed
    except ImportError as error:
        raise OptionError("option 'cluster' needs the package distributed: pip install 'nrsfm[cluster]'") from error
    return distributed


def facts() -> dict[str, str]:
    """What must be the same on every worker."""
    import nrsfm

    python = ".".join(platform.python_version_tuple()[:2])
    return {"nrsfm": nrsfm.__version__, "Python": python, "NumPy": np.__version__}


def _require_workers(client: Any) -> None:
    """Raise ``ClusterError`` where there are no workers for a while, or not like this process."""
    try:
        client.wait_for_workers(1, timeout=WAITING)
    except TimeoutError as error:
        raise ClusterError(
            f"cluster: the scheduler has no workers, and none came within {WAITING:g} s: start some with 'dask worker "
            f"{client.scheduler.address}'"
        ) from error
    own = facts()
    for address, theirs in _asked(client, facts).items():
        if isinstance(theirs, Exception):
            raise ClusterError(f"cluster: {address} cannot load nrsfm {own['nrsfm']}: {theirs}") from theirs
        for name, version in own.items():
            if theirs[name] != version:
                raise ClusterError(
                    f"cluster: every worker needs {name} {version}, as here; {address} has {theirs[name]}"
                )


def _asked(client: Any, function: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
    """What each worker answers, or the exception; a worker that is lost meanwhile does not count."""
    found = client.run(function, *arguments, on_error="return")
    return {address: answer for address, answer in found.items() if not isinstance(answer, OSError)}


def require_seen(client: Any, path: str | Path) -> None:
    """Raise ``FileError`` where a worker does not see a file or folder under the same path."""
    whole = os.path.abspath(path)
    for address, seen in _asked(client, os.path.exists, whole).items():
        if not seen:
            raise FileError(f"cluster: the worker {address} does not see '{whole}': every host needs the same path")
