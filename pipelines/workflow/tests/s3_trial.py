#!/usr/bin/env python3
"""A batch on an object store that refuses every tenth request: images from there, products and finished units there, and each unit on a
machine of its own that shares no disk with the others. The products must be those of a batch on one disk.

    pip install "moto[server]" boto3
    pipelines/workflow/tests/s3_trial.py PROGRAM FOLDER        (a new folder)
"""
import http.client
import http.server
import json
import logging
import os
import pathlib
import shutil
import socketserver
import subprocess
import sys
import threading

import boto3
from moto.server import ThreadedMotoServer

REFUSED = 10  # Every tenth request.
MANIFEST = """
{deliver}
[tiles]
side_m = 48.0
overlap_m = 6.0
block = 128

[products]
globe = true

[[images]]
name = "first"
scene = "{scene}"

[[presets]]
name = "sweep"

[[presets]]
name = "quick"
preset = "fast"
set = {{ "train.iterations" = 12, "train.epochs" = 100 }}
"""


class Proxy(http.server.BaseHTTPRequestHandler):
    """Passes requests on to the store, and refuses some."""

    protocol_version = "HTTP/1.1"
    store = 0
    count = 0

    def pass_on(self):
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        Proxy.count += 1
        if Proxy.count % REFUSED == 0:
            self.send_response(503)
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        link = http.client.HTTPConnection("127.0.0.1", Proxy.store)
        link.request(self.command, self.path, body, {**self.headers, "Host": f"127.0.0.1:{Proxy.store}"})
        answer = link.getresponse()
        content = answer.read()
        self.send_response(answer.status)
        for key, value in answer.getheaders():
            if key.lower() not in ("transfer-encoding", "content-length", "connection"):
                self.send_header(key, value)
        is_head = self.command == "HEAD"
        self.send_header("Content-Length", answer.getheader("Content-Length", "0") if is_head else str(len(content)))
        self.end_headers()
        self.wfile.write(b"" if is_head else content)

    do_GET = do_PUT = do_HEAD = do_POST = do_DELETE = pass_on

    def log_message(self, *_):
        pass


class Server(socketserver.ThreadingMixIn, http.server.HTTPServer):
    daemon_threads = True


def main():
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    program, folder = os.path.abspath(sys.argv[1]), pathlib.Path(sys.argv[2])
    folder.mkdir(parents=True)
    os.chdir(folder)
    store = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    store.start()
    Proxy.store = store.get_host_and_port()[1]
    proxy = Server(("127.0.0.1", 0), Proxy)
    threading.Thread(target=proxy.serve_forever, daemon=True).start()
    keys = {"AWS_ACCESS_KEY_ID": "a", "AWS_SECRET_ACCESS_KEY": "b", "AWS_REGION": "us-east-1"}
    os.environ.update(keys, AWS_S3_ENDPOINT=f"127.0.0.1:{proxy.server_port}", AWS_HTTPS="NO", AWS_VIRTUAL_HOSTING="FALSE")

    def run(*words):
        done = subprocess.run([program, *words, "--quiet"], stdout=subprocess.PIPE, text=True)
        if done.returncode != 0:
            sys.exit(f"{' '.join(words)}: exit code {done.returncode}")
        return done.stdout

    run("synth", "satellite", "--site", "tiny", "--seed", "5", "--out", "all")
    # Folders on a store have neither truth nor sidecars.
    scene = pathlib.Path("scene")
    scene.mkdir()
    for image in pathlib.Path("all").glob("*.tif"):
        image.rename(scene / image.name)
    client = boto3.client(
        "s3", endpoint_url=f"http://127.0.0.1:{Proxy.store}", aws_access_key_id="a", aws_secret_access_key="b", region_name="us-east-1"
    )
    client.create_bucket(Bucket="bucket")
    for image in scene.iterdir():
        client.upload_file(str(image), "bucket", f"scene/{image.name}")
    pathlib.Path("disk.toml").write_text(MANIFEST.format(deliver="", scene="scene"))
    deliver = 'deliver = "/vsis3/bucket/out"'
    pathlib.Path("store.toml").write_text(MANIFEST.format(deliver=deliver, scene="/vsis3/bucket/scene"))
    run("batch", "disk.toml", "--out", "disk")
    units = json.loads(run("batch", "store.toml", "--out", "plan", "--plan", "--json"))["units"]
    for place, unit in enumerate(units):
        # The plan travels with the program; without it, each machine makes it again.
        shutil.copytree("plan", f"machine{place}")
        run("batch", "store.toml", "--out", f"machine{place}", "--only", unit["id"])
    compared, unlike = 0, []
    for stamp in sorted(pathlib.Path("disk").rglob("unit.json")):
        for output in json.loads(stamp.read_text())["outputs"]:
            file = stamp.parent / output["path"]
            # Pages and metrics name times and paths.
            if file.suffix in (".tif", ".vrt", ".ply", ".laz", ".glb"):
                name = str(file.relative_to("disk"))
                kept = client.get_object(Bucket="bucket", Key=f"out/{name}")["Body"].read()
                compared += 1
                unlike += [name] if kept != file.read_bytes() else []
    print(f"{len(units)} units, {Proxy.count} requests, one in {REFUSED} refused: {compared} files, {len(unlike)} differ {unlike[:5]}")
    sys.exit(1 if unlike or not compared else 0)


main()
