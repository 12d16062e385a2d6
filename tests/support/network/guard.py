"""A hook that ends whatever opens a connection beyond this machine, or listens for one.

`install` puts it into this process and, by a `sitecustomize` in the folder beside this file, into all Python processes
that are started from it. What compiled code does by itself only strace sees (`tests.support.network.system_calls`).
"""

from __future__ import annotations

import os
import sys
from ipaddress import ip_address
from pathlib import Path

EVENTS = {"socket.connect", "socket.bind", "socket.sendto", "socket.sendmsg"}
"""Python's own audit events, with the socket and the address: https://docs.python.org/3/library/audit_events.html."""

STARTED_WITH = Path(__file__).with_name("started_with")


class BeyondThisMachine(PermissionError):
    """A connection beyond this machine was about to be opened, or asked for."""


def stays_here(address: object) -> bool:
    """Tell whether an address is one of this machine alone: a file's, none, or the loopback.

    Args:
        address: as `socket` has it: a path, or a tuple of host and port.
    """
    if not isinstance(address, tuple):
        return True  # AF_UNIX, or nothing at all.
    host = address[0]
    if not isinstance(host, str):
        return True  # AF_NETLINK: the kernel of this machine.
    if host == "localhost":
        return True
    try:
        return ip_address(host.partition("%")[0]).is_loopback
    except ValueError:
        return False  # Another name; "" is every address of this machine.


def hook(event: str, arguments: tuple) -> None:
    """Refuse a connection beyond this machine; for `sys.addaudithook`.

    Raises:
        BeyondThisMachine: naming the address.
    """
    if event in EVENTS and not stays_here(arguments[1]):
        raise BeyondThisMachine(f"{event}: expected addresses of this machine, found {arguments[1]}")


def install() -> None:
    """Refuse connections in this process, and in the Python processes that it starts."""
    sys.addaudithook(hook)
    there = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    os.environ["PYTHONPATH"] = os.pathsep.join([str(STARTED_WITH), *filter(None, there)])
