"""A real MQTT broker, started for a test."""

from __future__ import annotations

import os
import pwd
import shutil
import socket
import subprocess
import time
from pathlib import Path

import pytest


class Mosquitto:
    """A broker on a port of its own, for the user ``bob``; skips the test if there is none.

    Attributes
    ----------
    url : str
        Its address, with the password and a topic.
    """

    def __init__(self, folder: Path, *, tls: bool = False, keeps: bool = True) -> None:
        program = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
        if program is None or shutil.which("openssl") is None:
            pytest.skip("no real broker on this machine: install the packages mosquitto and openssl")
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = int(free.getsockname()[1])
        passwords = folder / "passwords"
        subprocess.run(["mosquitto_passwd", "-b", "-c", str(passwords), "bob", "s3cret"], check=True)
        settings = {
            "listener": f"{self.port} 127.0.0.1",
            "password_file": passwords,
            "persistence": "true" if keeps else "false",
            "persistence_location": f"{folder}/",
            "user": pwd.getpwuid(os.getuid()).pw_name,
        }
        if tls:
            self.certificate, key = folder / "certificate.pem", folder / "key.pem"
            settings |= {"certfile": self.certificate, "keyfile": key}
            for_here = ("-days", "2", "-subj", "/CN=yard", "-addext", "subjectAltName=IP:127.0.0.1")
            files = ("-keyout", str(key), "-out", str(self.certificate))
            subprocess.run(
                ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", *for_here, *files],
                check=True,
                capture_output=True,
            )
        configuration = folder / "mosquitto.conf"
        configuration.write_text("".join(f"{name} {value}\n" for name, value in settings.items()))
        self.url = f"mqtt{'s' if tls else ''}://bob:s3cret@127.0.0.1:{self.port}/yard/events"
        self._command = [program, "-c", str(configuration)]
        self.begin()

    def begin(self) -> None:
        """Start it, and wait until it listens."""
        self._process = subprocess.Popen(self._command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while not self._listens():
            time.sleep(0.02)

    def end(self) -> None:
        """Stop it."""
        self._process.terminate()
        self._process.wait()

    def _listens(self) -> bool:
        try:
            socket.create_connection(("127.0.0.1", self.port)).close()
        except OSError:
            return False
        return True
