"""A small server that huggingface_hub takes for the Hugging Face hub, for datasets alone, in memory.

Files of 1 kB and more are LFS objects, as large files are on the hub. It can be told to send a file damaged, in part,
or slowly, and counts what it was asked for.
"""

import base64
import hashlib
import json
import threading
import urllib.parse
from collections import Counter
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

LFS_FROM = 1000
"""Bytes from which a file is uploaded as an LFS object."""


def sha256(content: bytes) -> str:
    """The id of an LFS object."""
    return hashlib.sha256(content).hexdigest()


def git_oid(content: bytes) -> str:
    """The id of a small file, which lies in the repository itself."""
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()


class HubServer(ThreadingHTTPServer):
    """Serves repositories of datasets at `url`.

    Attributes:
        repositories: name → path → content.
        objects: LFS objects, sha256 → content.
        cut: part of a path → bytes after which the connection ends, once for each entry in the list.
        changed: part of a path → what is sent instead.
        held: part of a path; of such a file half is sent, then `hold` is set and the rest never comes.
        sent: path → how often its content was asked for.
        refused_uploads: paths in a repository that no commit may write.
        tokens: how often a service account of Google's asked for one; the emulator of their storage has no such place.
    """

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.repositories: dict[str, dict[str, bytes]] = {}
        self.commits: Counter[str] = Counter()
        self.objects: dict[str, bytes] = {}
        self.cut: dict[str, list[int]] = {}
        self.changed: dict[str, bytes] = {}
        self.held = ""
        self.hold, self.release = threading.Event(), threading.Event()
        self.sent: Counter[str] = Counter()
        self.refused_uploads: set[str] = set()
        self.tokens = 0
        self.url = f"http://127.0.0.1:{self.server_address[1]}"

    def __enter__(self) -> "HubServer":
        threading.Thread(target=self.serve_forever, args=(0.02,), daemon=True).start()
        return self

    def __exit__(self, *_) -> None:
        self.release.set()
        self.shutdown()
        self.server_close()

    def head(self, repository: str) -> str:
        """The id of its newest commit."""
        return hashlib.sha1(f"{repository} {self.commits[repository]}".encode()).hexdigest()

    def environment(self, tmp_path, name: str = "someone") -> dict[str, str]:
        """What makes Minari and huggingface_hub use this server; each `tmp_path` has a cache of its own."""
        return {
            "MINARI_REMOTE": f"hf://{name}",
            "HF_ENDPOINT": self.url,
            "HF_HUB_DISABLE_XET": "1",
            "HF_HOME": str(tmp_path / "hf"),
            "HF_TOKEN": "hf_of_the_test",
        }


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: HubServer

    def do_GET(self):
        url = urllib.parse.urlsplit(self.path)
        parts = urllib.parse.unquote(url.path).strip("/").split("/")
        query = urllib.parse.parse_qs(url.query)
        if parts == ["api", "datasets"]:
            wanted = (query.get("author", [""])[0], query.get("search", [""])[0])
            self.answer([self.about(name) for name in self.server.repositories if self.matches(name, *wanted)])
        elif parts[:2] == ["api", "datasets"]:
            self.repository("/".join(parts[2:4]), parts[4:])
        elif parts[0] == "datasets" and parts[3] == "resolve":
            self.file("/".join(parts[1:3]), "/".join(parts[5:]))
        else:
            self.missing("EntryNotFound")

    def do_HEAD(self):
        self.do_GET()

    def do_POST(self):
        body = self.rfile.read(int(self.headers["Content-Length"]))
        parts = urllib.parse.unquote(self.path).strip("/").split("/")
        if parts == ["api", "repos", "create"]:
            asked = json.loads(body)
            name = f"{asked['organization']}/{asked['name']}"
            status = 409 if name in self.server.repositories else 200
            self.server.repositories.setdefault(name, {})
            self.answer({"url": f"{self.server.url}/datasets/{name}"}, status)
        elif parts == ["token"]:
            self.server.tokens += 1
            self.answer({"access_token": "of the test", "token_type": "Bearer", "expires_in": 3600})
        elif parts[-3:] == ["lfs", "objects", "batch"]:
            self.answer({"transfer": "basic", "objects": [self.upload_of(o) for o in json.loads(body)["objects"]]})
        elif "/".join(parts[2:4]) not in self.server.repositories:
            self.missing("RepoNotFound")
        elif parts[4] == "preupload":
            there = self.server.repositories["/".join(parts[2:4])]
            self.answer({"files": [self.mode_of(file, there) for file in json.loads(body)["files"]]})
        elif parts[4] == "commit":
            self.commit("/".join(parts[2:4]), [json.loads(line) for line in body.splitlines()])
        else:
            self.missing("EntryNotFound")

    def do_PUT(self):
        if self.headers["Transfer-Encoding"] == "chunked":
            content = b""
            while size := int(self.rfile.readline(), 16):
                content += self.rfile.read(size)
                self.rfile.readline()
            self.rfile.readline()
        else:
            content = self.rfile.read(int(self.headers["Content-Length"]))
        oid = sha256(content)
        assert self.path == f"/lfs/{oid}"
        self.server.objects[oid] = content
        self.answer({})

    def matches(self, name, author, search):
        return name.startswith(f"{author}/") and search.lower() in name.lower()

    def about(self, name):
        siblings = [{"rfilename": path} for path in self.server.repositories[name]]
        return {"id": name, "sha": self.server.head(name), "private": False, "tags": [], "siblings": siblings}

    def repository(self, name, rest):
        if name not in self.server.repositories:
            self.missing("RepoNotFound")
        elif rest[:1] == ["tree"]:
            self.answer([self.entry(path, data) for path, data in self.server.repositories[name].items()])
        else:
            self.answer(self.about(name))

    def entry(self, path, content):
        lfs = {"oid": sha256(content), "size": len(content), "pointerSize": 130}
        return {
            "type": "file",
            "path": path,
            "size": len(content),
            "oid": git_oid(content),
            **({"lfs": lfs} if len(content) >= LFS_FROM else {}),
        }

    def mode_of(self, file, there):
        mode = {"path": file["path"], "uploadMode": "lfs" if file["size"] >= LFS_FROM else "regular"}
        content = there.get(file["path"])
        oid = None if content is None else git_oid(content) if len(content) < LFS_FROM else sha256(content)
        return {**mode, "shouldIgnore": False, "oid": oid}

    def upload_of(self, wanted):
        there = {"oid": wanted["oid"], "size": wanted["size"]}
        if wanted["oid"] in self.server.objects:
            return there
        return there | {"actions": {"upload": {"href": f"{self.server.url}/lfs/{wanted['oid']}"}}}

    def commit(self, name, lines):
        files = self.server.repositories[name]
        values = [(line["key"], line["value"]) for line in lines if line["key"] != "header"]
        if self.server.refused_uploads & {value["path"] for _, value in values}:
            self.answer({"error": "no"}, 403)
            return
        for key, value in values:
            is_object = key == "lfsFile"
            content = self.server.objects[value["oid"]] if is_object else base64.b64decode(value["content"])
            files[value["path"]] = content
        self.server.commits[name] += 1
        oid = self.server.head(name)
        self.answer({"commitUrl": f"{self.server.url}/datasets/{name}/commit/{oid}", "commitOid": oid})

    def file(self, name, path):
        if name not in self.server.repositories:
            self.missing("RepoNotFound")
            return
        content = self.server.repositories[name].get(path)
        if content is None:
            self.missing("EntryNotFound", self.server.head(name))
            return
        for part, other in self.server.changed.items():
            content = other if part in path else content
        first = 0
        if self.headers["Range"] and self.command == "GET":
            first = int(self.headers["Range"].removeprefix("bytes=").partition("-")[0])
        self.send_response(206 if first else 200)
        if first:
            self.send_header("Content-Range", f"bytes {first}-{len(content) - 1}/{len(content)}")
        self.send_header("Content-Length", str(len(content) - first))
        self.send_header("X-Repo-Commit", self.server.head(name))
        self.send_header("ETag", f'"{sha256(content)}"')
        self.end_headers()
        if self.command == "GET":
            self.server.sent[path] += 1
            self.body(path, content[first:])

    def body(self, path, content):
        for part, cuts in self.server.cut.items():
            if part in path and cuts:
                self.wfile.write(content[: cuts.pop(0)])
                self.close_connection = True
                return
        if self.server.held and self.server.held in path:
            self.wfile.write(content[: len(content) // 2])
            self.wfile.flush()
            self.server.hold.set()
            self.server.release.wait(60)
            self.close_connection = True
            return
        self.wfile.write(content)

    def answer(self, value, status=200):
        text = json.dumps(value).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(text)

    def missing(self, code, commit=None):
        self.send_response(404)
        self.send_header("X-Error-Code", code)
        if commit:
            self.send_header("X-Repo-Commit", commit)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_):
        pass
