"""System calls of processes that open connections or files, as strace prints them."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

TRACE = ("strace", "--follow-forks", "--seccomp-bpf", "--quiet=attach,exit", "--signal=none", "--decode-pids=comm",
         "--trace=connect,bind,sendto,sendmsg,sendmmsg,openat")  # fmt: skip

CALL = re.compile(r"\b(connect|bind|sendto|sendmsg|sendmmsg)\((.*)")
FAMILY = re.compile(r"sa_family=(AF_\w+)")
HOST = re.compile(r'inet_addr\("([^"]+)"\)|inet_pton\(AF_INET6, "([^"]+)"')

NEAR = {"AF_UNIX", "AF_LOCAL", "AF_NETLINK", "AF_UNSPEC"}
"""Families of addresses that are no network's."""


@cache
def why_not() -> str:
    """Reason why nothing can be traced here; empty where it can."""
    if shutil.which("strace") is None:
        return "no strace: apt-get install strace"
    with tempfile.NamedTemporaryFile() as log:
        done = subprocess.run([*TRACE, "--output", log.name, "true"], capture_output=True, text=True)
    return "" if done.returncode == 0 else f"strace cannot trace here: {done.stderr.strip()}"


def traced(command: list[str], log: Path) -> list[str]:
    """Words of a command whose connections and files, and those of all that it starts, are written to a log."""
    return [*TRACE, "--output", str(log), *command]


def beyond_this_machine(log: str) -> list[str]:
    """Lines of a trace that tell of an address that is not of this machine alone."""
    found = []
    for line in log.splitlines():
        if not (CALL.search(line) and (family := FAMILY.search(line))):
            continue  # Without an address it goes where an earlier call has said.
        hosts = [ip4 or ip6 for ip4, ip6 in HOST.findall(line)]
        loopback = bool(hosts) and all(host.startswith("127.") or host == "::1" for host in hosts)
        if family[1] not in NEAR and not loopback:
            found.append(line)
    return found
