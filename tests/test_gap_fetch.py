"""`gap fetch` against a server on this machine that cuts bodies, lies about sums, loses files and dies half way."""

import hashlib
import io
import json
import subprocess
import sys
import threading
import time
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from fishmj.base import console
from fishmj.base.errors import ConfigError, StoreError, UnknownName
from fishmj.base.store import Manifest
from fishmj.gap.measured import fetch

FILES = {f"log {i}.csv": f"t,x\n0,{i}\n".encode() * (2000 * (i + 1)) for i in range(3)}
LICENCE = b"do as you like\n"


class Server:
    """Serves `bodies` by path. `cut[path]` is a list of how many bytes to send before hanging up, one entry an answer."""

    def __init__(self):
        self.bodies: dict[str, bytes] = {}
        self.cut: dict[str, list[int]] = {}
        self.status: dict[str, list[int]] = {}
        self.asked: list[tuple[str, str]] = []
        self.ranges = True
        self.hang, self.release = threading.Event(), threading.Event()  # a stalled answer waits here, with the line open
        self.stall: set[str] = set()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                outer.answer(self)

            def log_message(self, *_):
                pass

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.thread = threading.Thread(target=self.http.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        self.thread.start()
        self.base = f"http://127.0.0.1:{self.http.server_port}"

    def answer(self, request):
        self.asked.append((request.path, request.headers.get("Range", "")))
        if self.status.get(request.path):
            return request.send_error(self.status[request.path].pop(0))
        body = self.bodies.get(request.path)
        if body is None:
            return request.send_error(404)
        start = int(request.headers["Range"][6:-1]) if request.headers.get("Range") and self.ranges else 0
        if start >= len(body) and start:
            return request.send_error(416)
        request.send_response(206 if start else 200)
        if start:
            request.send_header("Content-Range", f"bytes {start}-{len(body) - 1}/{len(body)}")
        request.send_header("Content-Length", str(len(body) - start))
        request.end_headers()
        cuts = self.cut.get(request.path, [])
        request.wfile.write(body[start : start + cuts.pop(0)] if cuts else body[start:])
        if request.path in self.stall:
            request.wfile.flush()
            self.stall.discard(request.path)
            self.hang.set()
            self.release.wait(600)

    def close(self):
        self.http.shutdown()
        self.http.server_close()


@pytest.fixture
def server(monkeypatch):
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(fetch, "PAUSE", 0.0)
    made = Server()
    yield made
    made.close()


def spec(files, archive=""):
    entries = "\n".join(
        f'"{name}" = {{ sha256 = "{hashlib.sha256(body).hexdigest()}", bytes = {len(body)} }}' for name, body in files.items()
    )
    place = f'archive = "{archive}"' if archive else 'folder = "some where"'
    return (
        f'repository = "who/what"\ncommit = "c0ffee"\n{place}\nlicence = "MIT"\nabout = "made up"\n[licence_file]\n'
        f'path = "LICENSE"\nsha256 = "{hashlib.sha256(LICENCE).hexdigest()}"\nbytes = {len(LICENCE)}\n[files]\n{entries}\n'
    )


@pytest.fixture
def made_up(tmp_path, monkeypatch, server):
    """A set of three files on the server, and its pinned description."""
    folder = tmp_path / "public"
    folder.mkdir()
    (folder / "made_up.toml").write_text(spec(FILES))
    monkeypatch.setattr(fetch, "FOLDER", folder)
    server.bodies = {f"/who/what/c0ffee/some%20where/{name.replace(' ', '%20')}": body for name, body in FILES.items()}
    server.bodies["/who/what/c0ffee/LICENSE"] = LICENCE
    return tmp_path / "out"


def first(server):
    return next(path for path in server.bodies if path.endswith("log%200.csv"))


def whole(out):
    assert {p.name for p in out.iterdir()} == {*FILES, "LICENSE", "manifest.json"}
    assert all((out / name).read_bytes() == body for name, body in FILES.items())
    Manifest.read(out).verify(out)
    return True


def test_a_set_arrives_whole_with_a_manifest_and_is_not_asked_for_again(made_up, server):
    got = fetch.fetch("made_up", made_up, server.base)
    assert whole(made_up) and got.downloaded == sum(map(len, FILES.values())) and got.kept == 0
    assert Manifest.read(made_up).meta == {
        "name": "made_up",
        "source": "github.com/who/what",
        "commit": "c0ffee",
        "licence": "MIT",
    }
    before = len(server.asked)
    assert fetch.fetch("made_up", made_up, server.base).kept == 3 and len(server.asked) == before


def test_a_body_that_breaks_off_goes_on_where_it_stopped(made_up, server):
    server.cut[first(server)] = [5000, 7000]
    fetch.fetch("made_up", made_up, server.base)
    assert whole(made_up)
    assert [r for path, r in server.asked if path == first(server)] == ["", "bytes=5000-", "bytes=12000-"]


def test_a_broken_line_leaves_only_right_files_and_the_next_run_goes_on(made_up, server):
    path = next(p for p in server.bodies if p.endswith("log%201.csv"))
    server.cut[path] = [3000, 0, 0]
    with pytest.raises(StoreError, match="3 tries; 3000 bytes are kept, and the same command resumes"):
        fetch.fetch("made_up", made_up, server.base)
    assert {p.name for p in made_up.iterdir() if not p.name.startswith(".")} == {"log 0.csv"}  # no manifest: not whole
    server.asked.clear()
    got = fetch.fetch("made_up", made_up, server.base)
    assert whole(made_up) and got.kept == 1 and server.asked[0] == (path, "bytes=3000-")


def test_a_killed_process_leaves_its_bytes_for_the_next(made_up, server, tmp_path):
    path = next(p for p in server.bodies if p.endswith("log%201.csv"))
    server.cut[path], server.stall = [9000], {path}
    code = (
        "import sys; from pathlib import Path; from fishmj.gap.measured import fetch; "
        "fetch.FOLDER = Path(sys.argv[1]); "
        "fetch.fetch('made_up', sys.argv[2], sys.argv[3])"
    )
    child = subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "public"), str(made_up), server.base])
    assert server.hang.wait(600)
    part = made_up / f".made_up-{fetch.public_set('made_up').files[1].sha256[:16]}.part"
    until = time.monotonic() + 600
    while (not part.is_file() or part.stat().st_size < 9000) and time.monotonic() < until:
        time.sleep(0.01)
    child.kill()
    child.wait()
    server.release.set()
    assert {p.name for p in made_up.iterdir() if not p.name.startswith(".")} == {"log 0.csv"}
    server.asked.clear()
    assert fetch.fetch("made_up", made_up, server.base).kept == 1 and whole(made_up)
    assert server.asked[0] == (path, "bytes=9000-")


def test_a_server_without_ranges_is_read_from_the_start(made_up, server):
    server.ranges, server.cut[first(server)] = False, [5000]
    fetch.fetch("made_up", made_up, server.base)
    assert whole(made_up)


def test_a_wrong_sum_is_refused_and_nothing_is_put_in_place(made_up, server):
    server.bodies[first(server)] = b"x" * len(FILES["log 0.csv"])
    with pytest.raises(StoreError, match=r"expected sha256 [0-9a-f]{64}, got [0-9a-f]{64} .*is not used"):
        fetch.fetch("made_up", made_up, server.base)
    assert not [p for p in made_up.iterdir() if p.suffix in (".csv", ".json", ".part")]


def test_a_part_of_an_older_state_is_thrown_away_and_fetched_afresh(made_up, server):
    pin = fetch.public_set("made_up").files[0]
    made_up.mkdir()
    (made_up / f".made_up-{pin.sha256[:16]}.part").write_bytes(b"stale" * 100)
    fetch.fetch("made_up", made_up, server.base)
    assert whole(made_up)


def test_a_file_that_grew_is_refused_before_it_fills_the_disk(made_up, server):
    server.bodies[first(server)] = FILES["log 0.csv"] + b"more"
    with pytest.raises(StoreError, match="expected at most"):
        fetch.fetch("made_up", made_up, server.base)


def test_a_damaged_local_file_is_replaced(made_up, server):
    fetch.fetch("made_up", made_up, server.base)
    (made_up / "log 2.csv").write_bytes(b"scribble")
    assert fetch.fetch("made_up", made_up, server.base).kept == 2 and whole(made_up)


def test_a_missing_file_is_named_with_its_address(made_up, server):
    path = first(server)
    del server.bodies[path]
    with pytest.raises(StoreError, match=r"log%200.csv: the server says 404 .* has the source moved\?"):
        fetch.fetch("made_up", made_up, server.base)
    assert sum(asked == path for asked, _ in server.asked) == 1  # a clear no is not asked again


def test_a_server_in_trouble_is_tried_again(made_up, server):
    server.status[first(server)] = [503, 500]
    fetch.fetch("made_up", made_up, server.base)
    assert whole(made_up)
    with pytest.raises(StoreError, match="URLError|Connection"):
        fetch.fetch("made_up", made_up.with_name("other"), "http://127.0.0.1:1")


def test_a_licence_that_moved_is_a_note_and_costs_no_data(made_up, server):
    del server.bodies["/who/what/c0ffee/LICENSE"]
    got = fetch.fetch("made_up", made_up, server.base)
    assert "MIT" in got.notes[0] and got.files == 3 and (made_up / "manifest.json").is_file()


def test_of_an_archive_only_pinned_members_are_unpacked(tmp_path, monkeypatch, server):
    folder = tmp_path / "public"
    folder.mkdir()
    (folder / "zipped.toml").write_text(spec({"a/one.txt": b"one", "b/one.txt": b"two"}, archive="deep/all.zip"))
    monkeypatch.setattr(fetch, "FOLDER", folder)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, body in {
            "top/a/one.txt": b"one",
            "top/b/one.txt": b"two",
            "top/c/secret.txt": b"no",
            "../a/evil.txt": b"no",
        }.items():
            archive.writestr(name, body)
    path = "/who/what/c0ffee/deep/all.zip"
    server.bodies = {path: buffer.getvalue(), "/who/what/c0ffee/LICENSE": LICENCE}
    server.cut[path] = [60]
    fetch.fetch("zipped", tmp_path / "out", server.base)
    assert {p.relative_to(tmp_path / "out").as_posix() for p in (tmp_path / "out").rglob("*.txt")} == {"a/one.txt", "b/one.txt"}
    (tmp_path / "out" / "a" / "one.txt").unlink()
    server.bodies[path] = buffer.getvalue()[:80]
    with pytest.raises(StoreError, match="not a sound zip archive"):
        fetch.fetch("zipped", tmp_path / "out", server.base)
    (folder / "zipped.toml").write_text(spec({"a/one.txt": b"uno"}, archive="deep/all.zip"))
    server.bodies[path] = buffer.getvalue()
    with pytest.raises(StoreError, match=r"member a/one.txt: 1 of its size, none with sha256 .* changed since it was pinned"):
        fetch.fetch("zipped", tmp_path / "third", server.base)


def test_bad_requests_are_refused_at_once(made_up, server, tmp_path):
    with pytest.raises(UnknownName, match="Did you mean 'made_up'"):
        fetch.fetch("madeup", made_up, server.base)
    with pytest.raises(ConfigError, match="begins with https"):
        fetch.fetch("made_up", made_up, "file:///etc")
    (tmp_path / "file").write_text("here")
    with pytest.raises(ConfigError, match="is a file"):
        fetch.fetch("made_up", tmp_path / "file", server.base)
    Manifest({}, {"name": "another"}).write(tmp_path / "taken")
    with pytest.raises(ConfigError, match="holds another, not made_up"):
        fetch.fetch("made_up", tmp_path / "taken", server.base)


def test_the_command_says_what_came(made_up, server, capsys):
    assert console.run(fetch.main, ["made_up", "--out", str(made_up), "--base-url", server.base, "--json"]) == 0
    assert json.loads(capsys.readouterr().out.strip().split("\n")[-1])["files"] == 3


def test_a_file_may_have_another_name_at_its_source(made_up, server):
    text = (fetch.FOLDER / "made_up.toml").read_text()
    name = first(server).rpartition("/")[2].replace("%20", " ")
    (fetch.FOLDER / "made_up.toml").write_text(text.replace(f'"{name}" = {{', f'"logs/one.csv" = {{ source = "{name}",'))
    fetch.fetch("made_up", made_up, server.base)
    assert (made_up / "logs" / "one.csv").read_bytes() == FILES[name]


@pytest.mark.parametrize("name", fetch.names())
def test_shipped_descriptions_are_complete(name):
    found = fetch.public_set(name)
    assert found.files and not (found.folder and found.archive) and found.licence in ("MIT", "Apache-2.0", "BSD-3-Clause")
    assert all(len(pin.sha256) == 64 and pin.bytes > 0 for pin in (*found.files, found.licence_file))
    assert found.commit == "HEAD" and found.note or len(found.commit) == 40
