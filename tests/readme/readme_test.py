#!/usr/bin/python3
"""Runs every command of README.md in order, in a folder of its own, and checks its C++ and its links.

The two commands that install packages are checked for their syntax only: this test runs inside the second one.
"""

import argparse
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time

INSTALLERS = {"./deploy/quickstart.sh", "./tests/run.sh"}


def blocks(text, language):
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def fail(message):
    sys.exit(f"README: {message}")


def check_links(source, text):
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        if "://" not in target and not (source / target).exists():
            fail(f"link to a missing file: {target}")


def check_cpp(source, text):
    """The C++ of the README is part of the example that it names."""
    example = (source / "client/examples/stream_frames.cc").read_text()
    for block in blocks(text, "cpp"):
        if block not in example:
            fail("its C++ differs from client/examples/stream_frames.cc")


def run(command, folder, servers):
    if command in INSTALLERS:
        subprocess.run(["sh", "-n", command], cwd=folder, check=True)
        return
    print(f"$ {command}", flush=True)
    if command.endswith("&"):
        servers.append(subprocess.Popen(["sh", "-c", "exec " + command[:-1]], cwd=folder))
        time.sleep(0.5)
        return
    finished = subprocess.run(["sh", "-c", command], cwd=folder, timeout=200)
    if finished.returncode != 0:
        fail(f"exit status {finished.returncode} of: {command}")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--source", type=pathlib.Path, required=True)
    parser.add_argument("--build", type=pathlib.Path, required=True)
    arguments = parser.parse_args()
    text = (arguments.source / "README.md").read_text()
    check_links(arguments.source, text)
    check_cpp(arguments.source, text)

    commands = [line for block in blocks(text, "sh") for line in block.splitlines() if line.strip()]
    if len(commands) < 8:
        fail(f"only {len(commands)} commands found")
    servers = []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("tests", "client", "deploy"):
            os.symlink(arguments.source / name, pathlib.Path(folder) / name)
        os.mkdir(pathlib.Path(folder) / "build")
        os.symlink(arguments.build, pathlib.Path(folder) / "build/release")
        os.environ["PYTHONPATH"] = str(arguments.build / "proto/python")
        try:
            for command in commands:
                run(command, folder, servers)
        finally:
            for server in servers:
                server.terminate()
                server.wait(timeout=30)
    print(f"{len(commands)} commands run")


if __name__ == "__main__":
    main()
