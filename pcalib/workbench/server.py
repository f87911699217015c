"""The page and what it asks for, over HTTP on the loopback interface.

Every address begins with a token that only the page knows. A request is answered where its Host is this server and,
where it changes something, its Origin is this page: another page in the same browser can neither read nor drive it.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
import re
import secrets
import socket
import tempfile
import threading
import urllib.parse
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from pathlib import Path
from typing import Any

from pcalib import files
from pcalib.errors import InputError, PcalibError
from pcalib.workbench import actions, session
from pcalib.workbench.actions import Task
from pcalib.workbench.session import Session, Wanted
from pcalib.workbench.worker import Worker

LOOPBACK = "127.0.0.1"
RECORDING = "application/vnd.rerun.rrd"
PAGE = {"": "index.html", "app.js": "app.js", "style.css": "style.css"}
TYPES = {
    ".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8",
    ".json": "application/json", ".csv": "text/csv; charset=utf-8", ".toml": "text/plain; charset=utf-8",
    ".py": "text/plain; charset=utf-8", ".sh": "text/plain; charset=utf-8", ".c": "text/plain; charset=utf-8",
    ".h": "text/plain; charset=utf-8", ".rrd": RECORDING,
}  # fmt: skip
REPORT = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox"
"""What a report of a command may do in the page: show itself. It runs no script and loads nothing."""
KNOWN = (
    *(f"q{i}_deg" for i in range(1, 7)), *(f"q{i}_mm" for i in range(1, 7)), "x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg",
    "rz_deg", "qw", "qx", "qy", "qz", "tool_x_mm", "tool_y_mm", "tool_z_mm", "payload_kg", "time_s", "temp_degC",
    "temp_arms_degC", "temp_rods_degC", "temp_base_degC", "dir1", "dir2", "dir3", "pose_id", "set",
)  # fmt: skip
"""Names of columns that the page offers, see docs/files.md."""
_COLUMN = re.compile(r"\w{1,60}", re.ASCII)
_NAMED = re.compile(r"#\s*columns\s*=")
OWN = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; " \
    "frame-src 'self' http://127.0.0.1:*; form-action 'none'; base-uri 'none'; frame-ancestors 'none'"  # fmt: skip


class Workbench:
    """One session and its worker; requests come from several threads."""

    def __init__(self, folder: Path, host: str = LOOPBACK, password: str = "") -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = threading.Lock()
        self._session = session.load(folder)
        self.folder = folder
        self.host, self.password = host, password
        self._agreed: dict[str, str] = {}
        self.token = secrets.token_urlsafe(24)
        self.worker = Worker(folder, self._ended, self._record_pending)
        with contextlib.suppress(InputError):  # what can no longer be done is left
            self.worker.add(*actions.queue(self._session.pending, self._session))

    @cached_property
    def viewer(self) -> str:
        """Origin of the Rerun viewer's own pages, which show recordings and come from its package; '' without it, and
        for other computers, to which it does not speak."""
        if self.host != LOOPBACK:
            return ""
        try:
            import rerun as rr
        except ImportError:
            return ""
        port = _free_port()
        rr.serve_web_viewer(web_port=port, open_browser=False)
        return f"http://127.0.0.1:{port}"

    def _keep(self, changed: Session) -> None:
        session.save(changed)
        self._session = changed

    def _ended(self, task: Task) -> None:
        with self._lock:  # in one, so that no task is done twice, whenever the program is killed
            self._keep(replace(actions.done(self._session, task), pending=self._pending()[1:]))

    def _pending(self) -> tuple[Wanted, ...]:
        return tuple(Wanted(task.action, task.asked, task.model) for task in self.worker.pending())

    def _record_pending(self) -> None:
        with self._lock:
            pending = self._pending()
            if pending != self._session.pending:
                self._keep(replace(self._session, pending=pending))

    def state(self) -> dict[str, Any]:
        """Everything that the page shows."""
        with self._lock:
            now = self._session
        stem = Path(now.step.model).stem if now.step else ""
        written = {
            name: actions.read(self.folder / f"{stem}.{name}.json")
            for name in ("compare", "diagnose", "look", "try", "laws", "view") if stem
        }  # fmt: skip
        return {
            **now.as_json(),
            "agreed": self.agreed(),
            "viewer": f"{self.viewer}/" if any(f.suffix == ".rrd" for f in self.folder.iterdir()) else "",
            "inspect": actions.read(self.folder / "inspect.json") if now.data else {},
            "written": {name: content for name, content in written.items() if content},
            "files": session.names(now, (".csv", ".parquet", ".toml", ".html", ".json", ".rrd")),
            "jobs": [
                {"number": j.number, "action": j.task.action, "says": j.task.says, "state": j.state,
                 "seconds": round(j.seconds, 1), "said": j.said, "words": ["pcalib", *j.task.words]}
                for j in self.worker.jobs()
            ],
        }  # fmt: skip

    def run(self, action: str, asked: Mapping[str, str]) -> None:
        """Queue an action, or the chain of actions that follows new data.

        Raises:
            InputError: the session is not ready for it.
        """
        with self._lock:
            now = self._session
        wanted = actions.tasks(action, now, asked, self.agreed())
        if any(task.model for task in wanted):
            self._no_step_is_made()
        pending = self.worker.pending()
        self.worker.add(*(task for task in wanted if task not in pending))

    def code(self, spec: str) -> dict[str, str]:
        """The code of a law that was proposed in this session, and its digest.

        Raises:
            InputError: there is no such law.
        """
        path = self.folder / spec.partition(":")[0]
        if not session.LAW.fullmatch(spec) or path.is_symlink() or path.parent.is_symlink() or not path.is_file():
            raise InputError(f"'{spec:.60}' is no law of this session")
        text = files.read_text(path)
        return {"spec": spec, "text": text, "digest": hashlib.sha256(text.encode()).hexdigest()}

    def agree(self, spec: str, digest: str) -> None:
        """Let the code of a law run, as it was shown.

        Raises:
            InputError: there is no such law, or it is not what was shown.
        """
        if not secrets.compare_digest(self.code(spec)["digest"].encode(), digest.encode()):
            raise InputError(f"{spec} is not what was shown", remedy="look at it again")
        self._agreed[spec] = digest

    def agreed(self) -> list[str]:
        """Laws that somebody agreed to since this program was started, and that are what they were."""
        out = []
        for spec, digest in self._agreed.items():
            with contextlib.suppress(InputError):
                if self.code(spec)["digest"] == digest:
                    out.append(spec)
        return out

    def _no_step_is_made(self) -> None:
        if any(task.model for task in self.worker.pending()):
            raise InputError("a step is being made", remedy="wait until it is there, or cancel it")

    def go_on(self) -> None:
        """Start the first fit where the session has no step yet."""
        if not self._session.steps and not self.worker.pending():
            self.run("begin", {})

    def look_at(self, at: int) -> None:
        """Go to a step of the history."""
        with self._lock:
            if not 0 <= at < len(self._session.steps):
                raise InputError(f"the history has no step {at}")
            self._keep(replace(self._session, at=at))

    def back(self) -> None:
        """Take the steps behind the one that is looked at out of the history; their files stay."""
        self._no_step_is_made()
        with self._lock:
            at = self._session.at
            self._keep(replace(self._session, steps=self._session.steps[: at + 1]))

    def take(self, name: str, content: bytes, role: str = "") -> str:
        """Keep a file that was handed over; what it was taken for: 'robot', 'data', 'targets' or 'rows'."""
        if not session.is_name(name):
            raise InputError(f"'{name[:40]}' is no name for a file here", remedy="use letters, digits, - and _")
        what = role or session.kind_of(name, content)
        if what in ("targets", "rows") and name in (self._session.data, self._session.robot):
            raise InputError(f"{name} is a file of this session", remedy="give the other one another name")
        if what == "rows":
            _require_measurements(name, content)
        known = self._session.data if what == "data" else self._session.robot if what == "robot" else ""
        if name == known and (self.folder / name).exists() and (self.folder / name).read_bytes() == content:
            return what  # what was done with it stands
        if known:
            self.worker.cancel()
        with files.atomic(self.folder / name) as temporary:
            temporary.write_bytes(content)
        with self._lock:
            if what in ("data", "robot"):
                self._keep(replace(self._session, **{what: name}, steps=(), commands=(), at=-1))
        return what

    def columns(self) -> dict[str, list[str]]:
        """The columns of the data, and the names that files of measurements use.

        Raises:
            InputError: there are no data, or they are no table.
        """
        from pcalib.data import table

        if not self._session.data:
            raise InputError("there are no data yet")
        return {"columns": list(table.read(self.folder / self._session.data).columns), "known": list(KNOWN)}

    def name_columns(self, names: str) -> None:
        """Write a line above the header of the data that names their columns, as a person would by hand.

        Args:
            names: separated by commas, in order.

        Raises:
            InputError: there are no data, they are no CSV, or not every column has a name of its own.
        """
        given = [name.strip() for name in names.split(",")]
        if not self._session.data or not self._session.data.lower().endswith(".csv"):
            raise InputError("columns are named in a CSV file", remedy="rename others where the file is made")
        if len(given) != len(self.columns()["columns"]) or len(set(given)) < len(given) or not all(given):
            raise InputError("every column needs a name of its own")
        if not all(_COLUMN.fullmatch(name) for name in given):
            raise InputError("names of columns are letters, digits and _")
        path = self.folder / self._session.data
        lines = files.read_text(path).splitlines(keepends=True)
        kept = [line for line in lines if not _NAMED.match(line)]
        files.write_text(path, "".join([f"# columns = {','.join(given)}\n", *kept]))

    def example(self) -> None:
        """Put the built-in example in place: a Delta in which something is hidden."""
        for name in ("robot.toml", "data.csv"):
            content = resources.files("pcalib.workbench").joinpath("example", name).read_bytes()
            self.take(name, content)


class Handler(BaseHTTPRequestHandler):
    """Answers the requests of the page."""

    bench: Workbench
    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing: the terminal shows the address alone."""

    def do_GET(self) -> None:
        """The page, its state, and files of the session."""
        what = self._asked()
        if what is None:
            return
        path, query = what
        if path in PAGE:
            name = PAGE[path]
            content = resources.files("pcalib.workbench").joinpath("page", name).read_bytes()
            self._send(200, content, TYPES[Path(name).suffix], OWN)
        elif path == "state":
            self._json(200, self.bench.state())
        elif path in ("columns", "code"):
            try:
                self._json(200, self.bench.columns() if path == "columns" else self.bench.code(query.get("spec", "")))
            except PcalibError as error:
                self._json(400, {"problem": str(error)})
        elif path == "session.sh":
            self._send(200, session.load(self.bench.folder).shell().encode(), TYPES[".sh"], REPORT)
        elif path == "session.py":
            self._send(200, session.load(self.bench.folder).python().encode(), TYPES[".py"], REPORT)
        elif path == "file":
            self._file(query.get("name", ""))
        elif path.startswith("recording/"):  # the viewer takes addresses that end so for recordings
            self._file(path.removeprefix("recording/"))
        else:
            self._json(404, {"problem": "there is no such page"})

    def do_POST(self) -> None:
        """Actions and uploads."""
        what = self._asked(changes=True)
        if what is None:
            return
        path, query = what
        try:
            length = int(self.headers.get("Content-Length") or "x")
        except ValueError:
            self._json(411, {"problem": "the size of what is sent has to be said"})
            return
        if not 0 <= length <= session.LARGEST:
            self.close_connection = True
            self._json(413, {"problem": f"files of more than {session.LARGEST // 2**20} MiB are not taken here"})
            return
        body = self.rfile.read(length)
        try:
            self._json(200, self._act(path, query, body))
        except PcalibError as error:
            self._json(400, {"problem": str(error)})

    def _act(self, path: str, query: Mapping[str, str], body: bytes) -> dict[str, Any]:
        bench = self.bench
        if path == "upload":
            role = query.get("as", "")
            return {"taken": bench.take(query.get("name", ""), body, role if role in ("targets", "rows") else "")}
        if path == "example":
            bench.example()
            bench.run("begin", {})
        elif path == "run":
            bench.run(query.get("action", ""), {name: said for name, said in query.items() if name != "action"})
        elif path == "agree":
            bench.agree(query.get("spec", ""), query.get("digest", ""))
        elif path == "columns":
            bench.name_columns(query.get("names", ""))
            bench.run("begin", {})
        elif path == "cancel":
            bench.worker.cancel()
        elif path == "at":
            bench.look_at(int(query["step"]) if query.get("step", "").isdigit() else -1)
        elif path == "back":
            bench.back()
        else:
            raise InputError("there is no such action")
        return {}

    def _asked(self, changes: bool = False) -> tuple[str, dict[str, str]] | None:
        """Path behind the token, and query; None where the request is refused, which has then been said."""
        port = self.connection.getsockname()[1]
        own = {f"{self.bench.host}:{port}"} | ({f"localhost:{port}"} if self.bench.host == LOOPBACK else set())
        if self.headers.get("Host") not in own:
            return self._refuse("this server answers to its own name only")
        origin = self.headers.get("Origin")
        address = urllib.parse.urlsplit(self.path)
        recording = not changes and address.path.endswith(".rrd")
        viewer = recording and bool(origin) and origin == self.bench.viewer
        if (changes or origin) and not viewer and origin not in {f"http://{host}" for host in own}:
            return self._refuse("another page may not ask")
        token, _, path = address.path.lstrip("/").partition("/")
        if not secrets.compare_digest(token.encode(), self.bench.token.encode()):
            return self._refuse("the address is not complete: copy it from the terminal")
        if self.bench.password and not self._knows_the_password():
            return None
        return path, dict(urllib.parse.parse_qsl(address.query))

    def _knows_the_password(self) -> bool:
        """Whether the request carries the password; it has been asked for where not (HTTP basic, RFC 7617)."""
        _, _, coded = self.headers.get("Authorization", "").partition("Basic ")
        try:
            _, _, said = base64.b64decode(coded, validate=True).partition(b":")
        except ValueError:
            said = b""
        if secrets.compare_digest(said, self.bench.password.encode()):
            return True
        self.close_connection = True
        self.send_response(401)
        self.send_header("WWW-Authenticate", 'Basic realm="pcalib workbench", charset="UTF-8"')
        self.send_header("Content-Length", "0")
        self.end_headers()
        return False

    def _refuse(self, problem: str) -> None:
        self.close_connection = True
        self._json(403, {"problem": problem})

    def _file(self, name: str) -> None:
        path = self.bench.folder / name
        if not session.is_name(name) or path.is_symlink() or not path.is_file():
            self._json(404, {"problem": "there is no such file in the session's folder"})
            return
        self._send(200, path.read_bytes(), TYPES.get(path.suffix, "application/octet-stream"), REPORT)

    def _json(self, status: int, content: Mapping[str, Any]) -> None:
        self._send(status, json.dumps(content).encode(), TYPES[".json"], REPORT)

    def _send(self, status: int, content: bytes, kind: str, policy: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Content-Security-Policy", policy)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("Cache-Control", "no-store")
        if kind == RECORDING:
            self.send_header("Access-Control-Allow-Origin", self.bench.viewer)
        self.end_headers()
        try:
            self.wfile.write(content)
        except (BrokenPipeError, ConnectionResetError):
            self.close_connection = True


def _require_measurements(name: str, content: bytes) -> None:
    """Refuse rows to join that are no measurements, before they are kept.

    Raises:
        InputError: what is wrong with them.
    """
    from pcalib.data import measurement

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        measurement.load(path)


def _free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def serve(
    folder: Path, port: int = 0, host: str = LOOPBACK, password: str = ""
) -> tuple[ThreadingHTTPServer, Workbench]:
    """A server that is ready to run, on the loopback interface or on that of an address, and its workbench.

    Args:
        port: 0 takes a free one.
        password: what other computers have to know besides the page's address.

    Raises:
        InputError: the port is taken, the address is not this computer's, or the folder's record is damaged.
    """
    bench = Workbench(folder, host, password)
    handler = type("BoundHandler", (Handler,), {"bench": bench})
    try:
        server = ThreadingHTTPServer((host, port), handler)
    except OSError as error:
        bench.worker.close()
        remedy = "leave --port out" if host == LOOPBACK else "name an address of this computer, or leave --port out"
        raise InputError(f"{host}, port {port} cannot be used: {error.strerror}", remedy=remedy) from None
    server.daemon_threads = True
    return server, bench


def address(server: ThreadingHTTPServer, bench: Workbench) -> str:
    """The address of the page."""
    return f"http://{bench.host}:{server.server_port}/{bench.token}/"
