"""A server on localhost that speaks the hub's API as far as publishing a dataset needs it.

What it takes is kept in memory, and judged as the hub does: an object must have the bytes of its
name, and a commit may only name objects that are there.
"""

import base64
import hashlib
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import unquote, urlsplit

TOKEN = "hf_of_a_test"  # noqa: S105  # of this server only
LARGE = (".zip", ".parquet")


@dataclass
class Repository:
    """A dataset repository: its commits, newest last, and tags."""

    private: bool
    commits: list[tuple[str, dict[str, bytes]]] = field(default_factory=list)
    tags: dict[str, str] = field(default_factory=dict)

    @property
    def files(self) -> dict[str, bytes]:
        return self.commits[-1][1]

    def at(self, revision: str) -> tuple[str, dict[str, bytes]] | None:
        wanted = self.tags.get(revision, revision)
        if wanted == "main":
            return self.commits[-1]
        return next((one for one in self.commits if one[0] == wanted), None)

    def commit(self, files: dict[str, bytes]) -> str:
        name = hashlib.sha1(str(len(self.commits)).encode()).hexdigest()  # noqa: S324  # as git
        self.commits.append((name, files))
        return name


@dataclass
class Hub:
    """The server's state. `uploads` are the objects that were sent, in order."""

    url: str = ""
    repositories: dict[str, Repository] = field(default_factory=dict)
    objects: dict[str, bytes] = field(default_factory=dict)
    uploads: list[str] = field(default_factory=list)
    refuse_after: int | None = None
    hang_after: int | None = None
    is_broken: bool = False
    # Parts of addresses, the answers that requests to them get, and how many still do.
    troubles: dict[str, tuple[int, int]] = field(default_factory=dict)
    hanging: threading.Event = field(default_factory=threading.Event)
    go_on: threading.Event = field(default_factory=threading.Event)
    counting: Any = field(default_factory=threading.Lock)


@contextmanager
def running_hub() -> Iterator[Hub]:
    """Run the server."""
    hub = Hub()

    class Handler(_Handler):
        state = hub

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    hub.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield hub
    finally:
        hub.go_on.set()
        server.shutdown()
        thread.join()
        server.server_close()


class _Handler(BaseHTTPRequestHandler):
    state: Hub
    protocol_version = "HTTP/1.1"

    def log_message(self, *_: object) -> None:
        pass

    def do_GET(self) -> None:
        self._answer()

    def do_HEAD(self) -> None:
        self._answer()

    def do_POST(self) -> None:
        self._answer()

    def do_PUT(self) -> None:
        self._answer()

    def _answer(self) -> None:
        path = unquote(urlsplit(self.path).path)
        body = self._body()
        if self._is_troubled(path):
            return
        if path.startswith("/objects/"):
            self._put(path.removeprefix("/objects/"), body)
        elif self.headers.get("Authorization") != f"Bearer {TOKEN}":
            self._send(401, {"error": "Invalid credentials"})
        elif path == "/api/repos/create":
            self._create(json.loads(body))
        elif path == "/api/validate-yaml":
            self._send(200, {"warnings": [], "errors": []})
        elif path.startswith("/datasets/") and "/resolve/" in path:
            name, _, rest = path.removeprefix("/datasets/").partition("/resolve/")
            self._resolve(name, *rest.split("/", 1))
        elif path.startswith("/datasets/"):
            self._batch(json.loads(body))
        else:
            self._of_repository(path.removeprefix("/api/datasets/").split("/"), body)

    def _is_troubled(self, path: str) -> bool:
        for part, (code, times) in self.state.troubles.items():
            if part in path and times > 0:
                self.state.troubles[part] = (code, times - 1)
                self._send(code, {"error": "not now"}, {"Retry-After": "0"})
                return True
        return False

    def _of_repository(self, parts: list[str], body: bytes) -> None:
        repository = self.state.repositories.get("/".join(parts[:2]))
        if repository is None:
            self._send(404, {"error": "Not Found"}, {"X-Error-Code": "RepoNotFound"})
        else:
            getattr(self, f"_{parts[2]}")(repository, parts, body)

    def _body(self) -> bytes:
        if self.headers.get("Transfer-Encoding", "") == "chunked":
            pieces = []
            while size := int(self.rfile.readline(), 16):
                pieces.append(self.rfile.read(size))
                self.rfile.readline()
            self.rfile.readline()
            return b"".join(pieces)
        return self.rfile.read(int(self.headers.get("Content-Length", 0)))

    def _send(self, code: int, document: Any, headers: dict[str, str] | None = None) -> None:
        content = document if isinstance(document, bytes) else json.dumps(document).encode()
        self.send_response(code)
        for key, value in (headers or {}).items():
            self.send_header(key, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def _create(self, asked: dict[str, Any]) -> None:
        name = f"{asked['organization']}/{asked['name']}"
        assert asked["type"] == "dataset"
        url = {"url": f"{self.state.url}/datasets/{name}"}
        if name in self.state.repositories:
            self._send(409, {"error": "You already created this repo", **url})
            return
        private = asked.get("visibility") == "private" or asked.get("private") is True
        made = self.state.repositories[name] = Repository(private)
        made.commit({".gitattributes": b"*.zip filter=lfs\n"})
        self._send(200, url)

    def _refs(self, repository: Repository, *_: object) -> None:
        head = repository.commits[-1][0]
        tags = [
            {"name": name, "ref": f"refs/tags/{name}", "targetCommit": commit}
            for name, commit in repository.tags.items()
        ]
        main = {"name": "main", "ref": "refs/heads/main", "targetCommit": head}
        self._send(200, {"branches": [main], "converts": [], "tags": tags})

    def _tree(self, repository: Repository, *_: object) -> None:
        listed = [
            {"type": "file", "path": path, "size": len(content), "oid": _blob(content)}
            for path, content in repository.files.items()
        ]
        self._send(200, listed)

    def _revision(self, repository: Repository, *_: object) -> None:
        self._send(200, {"id": "a/b", "sha": repository.commits[-1][0], "siblings": []})

    def _preupload(self, repository: Repository, _parts: object, body: bytes) -> None:
        answers = []
        for asked in json.loads(body)["files"]:
            there = repository.files.get(asked["path"])
            is_large = asked["path"].endswith(LARGE)
            oid = None
            if there is not None:
                oid = hashlib.sha256(there).hexdigest() if is_large else _blob(there)
            mode = "lfs" if is_large else "regular"
            answers.append(
                {"path": asked["path"], "uploadMode": mode, "shouldIgnore": False, "oid": oid}
            )
        self._send(200, {"files": answers})

    def _batch(self, asked: dict[str, Any]) -> None:
        answers = []
        for one in asked["objects"]:
            answer = {"oid": one["oid"], "size": one["size"]}
            if one["oid"] not in self.state.objects:
                href = f"{self.state.url}/objects/{one['oid']}"
                answer["actions"] = {"upload": {"href": href, "header": {}}}
            answers.append(answer)
        self._send(200, {"transfer": "basic", "objects": answers})

    def _put(self, oid: str, body: bytes) -> None:
        state = self.state
        if hashlib.sha256(body).hexdigest() != oid:
            self._send(400, {"error": "other bytes than their name says"})
            return
        with state.counting:  # uploads come several at a time
            count = len(state.uploads)
            hangs = state.hang_after is not None and count >= state.hang_after
            is_refused = state.refuse_after is not None and count >= state.refuse_after
            if not (hangs or is_refused):
                state.objects[oid] = body
                state.uploads.append(oid)
        if hangs:
            state.hanging.set()
            state.go_on.wait(30)
            self.close_connection = True
        elif is_refused:
            self._send(403, {"error": "The quota is used up"})
        else:
            self._send(200, {})

    def _commit(self, repository: Repository, parts: list[str], body: bytes) -> None:
        files = dict(repository.files)
        for line in body.splitlines():
            asked = json.loads(line)
            value = asked["value"]
            if asked["key"] == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif asked["key"] == "lfsFile":
                if value["oid"] not in self.state.objects:
                    self._send(400, {"error": f"{value['path']} was never uploaded"})
                    return
                files[value["path"]] = self.state.objects[value["oid"]]
            elif asked["key"] == "deletedFile":
                del files[value["path"]]
        commit = repository.commit(files)
        url = f"{self.state.url}/datasets/{parts[0]}/{parts[1]}/commit/{commit}"
        self._send(200, {"commitUrl": url, "commitOid": commit, "success": True})

    def _tag(self, repository: Repository, parts: list[str], body: bytes) -> None:
        repository.tags[json.loads(body)["tag"]] = parts[3]
        self._send(200, {})

    def _resolve(self, name: str, revision: str, path: str) -> None:
        if self.state.is_broken:
            self._send(503, {"error": "Try again later"})
            return
        repository = self.state.repositories.get(name)
        found = repository.at(revision) if repository else None
        if found is None or path not in found[1]:
            self._send(404, {"error": "Not Found"}, {"X-Error-Code": "EntryNotFound"})
            return
        content = found[1][path]
        self._send(200, content, {"X-Repo-Commit": found[0], "ETag": f'"{_blob(content)}"'})


def _blob(content: bytes) -> str:
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()  # noqa: S324  # as git
