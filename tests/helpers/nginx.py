"""nginx, as many plants serve releases with it, over TLS from a folder."""

from __future__ import annotations

import subprocess
from pathlib import Path

from helpers.certificates import make_certificates
from helpers.ports import answers, free_port
from helpers.prometheus import program
from helpers.waiting import LIMIT_S, wait_until

CONFIG = """
daemon off; master_process off; pid {own}/pid; error_log {own}/log;
events {{}}
http {{
    access_log off;
    client_body_temp_path {own}; proxy_temp_path {own}; fastcgi_temp_path {own};
    uwsgi_temp_path {own}; scgi_temp_path {own};
    server {{
        listen 127.0.0.1:{port} ssl;
        ssl_certificate {own}/tls/server.pem; ssl_certificate_key {own}/tls/server.key;
        root {folder};
        location /targets/ {{ limit_rate {bytes_per_s}; }}
    }}
}}
"""


class Nginx:
    """A server of a folder that can be killed and restarted.

    own : folder of its files; in `tls/ca.pem` whom to trust.
    """

    def __init__(self, folder: Path, own: Path) -> None:
        (own / "tls").mkdir(parents=True)
        make_certificates(own / "tls")
        self._folder, self._own, self._port = folder, own, free_port()
        self._process: subprocess.Popen[bytes] | None = None
        self.url = f"https://127.0.0.1:{self._port}"

    def start(self, bytes_per_s: int = 0) -> None:
        """Start, and wait until it answers. bytes_per_s : at which targets are sent; 0: no limit."""
        config = self._own / "nginx.conf"
        config.write_text(
            CONFIG.format(own=self._own, folder=self._folder, port=self._port, bytes_per_s=bytes_per_s)
        )
        # -e: or else it opens the log of the whole machine before it reads its configuration
        command = [program("nginx"), "-e", str(self._own / "log"), "-p", str(self._own), "-c", str(config)]
        self._process = subprocess.Popen(command)
        wait_until(lambda: answers(self._port))

    def kill(self) -> None:
        """Kill it, as a power cut does."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(LIMIT_S)
            self._process = None
