"""MeshCat's server on an address of our choice: `python -m fishmj.view.replay.meshcat_server HOST`, which `LiveView` starts.

MeshCat's own launcher listens on every address of the machine. This server sends pages to HOST only, and takes commands for the
scene from this machine only. A request whose Host header is the name of another machine is refused: a page of a foreign site
that has its name point here would send it (DNS rebinding). Tornado refuses a websocket from another origin. The server ends
with its parent, which holds the other end of its standard input.
"""

import contextlib
import ipaddress
import os
import socket
import sys

import tornado.ioloop
import tornado.web
from meshcat.servers import zmqserver

from fishmj.base import console

LOCAL = "127.0.0.1"


def known_host(header: str, host: str) -> bool:
    """Returns True if a Host header names this server: an address, localhost, its own host, or this machine's name."""
    name = header.rsplit(":", 1)[0] if not header.endswith("]") else header
    name = name.strip("[]").lower()
    if name in {"localhost", host.lower(), socket.gethostname().lower()}:
        return True
    with contextlib.suppress(ValueError):
        ipaddress.ip_address(name)
        return True
    return False


class Guarded:
    """Refuses requests that came by a foreign name."""

    def prepare(self):
        """Answers 403 to a request whose Host header names another machine."""
        request, settings = self.request, self.application.settings
        if not known_host(request.headers.get("Host", ""), settings["host"]):
            raise tornado.web.HTTPError(403)


class Pages(Guarded, zmqserver.StaticFileHandlerNoCache):
    """The viewer."""


class Scenes(Guarded, zmqserver.WebSocketHandler):
    """Websocket that sends the scene to the viewer."""


class Application(tornado.web.Application):
    """Listens on one host."""

    def listen(self, port, address=None, **options):
        """Listens on `port` of the one host, unless another address is given."""
        return super().listen(port, address=address or self.settings["host"], **options)


class Bridge(zmqserver.ZMQWebSocketBridge):
    """MeshCat's bridge: pages and websockets on `host`, commands on this machine alone."""

    def __init__(self, host: str = LOCAL):
        super().__init__(zmq_url=f"tcp://{LOCAL}:*", host=host)
        shown = {"0.0.0.0": LOCAL, "::": LOCAL}.get(host, host)  # noqa: S104  compared, not bound
        self.web_url = f"http://{f'[{shown}]' if ':' in shown else shown}:{self.fileserver_port}/static/"

    def make_app(self):
        """Tornado application with the viewer's pages and its websocket."""
        handlers = [
            (r"/static/(.*)", Pages, {"path": zmqserver.VIEWER_ROOT, "default_filename": zmqserver.VIEWER_HTML}),
            (r"/", Scenes, {"bridge": self}),
        ]
        return Application(handlers, host=self.host)

    def setup_zmq(self, url):
        """Opens the command socket. Returns it, its stream, and the address that it was bound to."""
        socket_, stream, _ = super().setup_zmq(url)
        return socket_, stream, socket_.last_endpoint.decode()


def main(argv: list[str]) -> int:
    """Prints the two addresses on standard output, then serves until standard input ends."""
    bridge = Bridge(*argv[:1])
    console.say(bridge.zmq_url, bridge.web_url)
    sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115  MeshCat talks; nobody reads the pipe any more
    loop = tornado.ioloop.IOLoop.current()
    if os.name == "posix":
        loop.add_handler(sys.stdin.fileno(), lambda fd, events: loop.stop(), loop.READ)
    bridge.run()
    return console.OK


if __name__ == "__main__":
    raise SystemExit(console.run(main))
