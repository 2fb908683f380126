#!/usr/bin/env python3
"""A Lumicast viewer without a window: connects, asks for a picture, prints how it converges, saves it.

Needs Python 3.9 and `pip install websockets pillow`. The protocol is described in README.md beside this file.
"""

import argparse
import io
import json
import math
import struct
import sys
import time
import urllib.error
import urllib.request
from collections import namedtuple

HEADER = struct.Struct("<4s4B3Q6Hf4I")  # 64 bytes
JPEG, PNG, FLOAT = 1, 2, 3
FRAME, TILE = 1, 2
Header = namedtuple(
    "Header",
    "magic kind version codec flags revision frame camera_stamp width height full_width full_height x y"
    " error samples payload_bytes age_us reserved",
)


class Refused(Exception):
    """The server said no, or said something that cannot be read."""


def split_frame(message):
    """Header and payload of a binary message."""
    if len(message) < HEADER.size:
        raise Refused(f"a binary message has only {len(message)} bytes")
    header, payload = Header(*HEADER.unpack_from(message)), message[HEADER.size :]
    if header.magic != b"LCF1" or header.version != 1:
        raise Refused(f"not a frame of version 1: {message[:8]!r}")
    if header.payload_bytes != len(payload):
        raise Refused(f"{header.payload_bytes} bytes of payload announced, {len(payload)} came")
    return header, payload


def picture_of(header, payload):
    """The payload as a Pillow image; float radiance is cut at 1 and turned into sRGB."""
    from PIL import Image

    if header.codec != FLOAT:
        return Image.open(io.BytesIO(payload)).convert("RGB")
    radiance = (min(max(r, 0.0), 1.0) for (r,) in struct.iter_unpack("<f", payload))
    srgb = (12.92 * r if r <= 0.0031308 else 1.055 * r ** (1 / 2.4) - 0.055 for r in radiance)
    return Image.frombytes("RGB", (header.width, header.height), bytes(round(255 * s) for s in srgb))


def show(canvas, header, payload):
    """The whole picture after this message: a frame is scaled up to full size, a tile is pasted in."""
    from PIL import Image

    full_size = (header.full_width, header.full_height)
    if header.kind == FRAME:
        return picture_of(header, payload).resize(full_size)
    if header.kind == TILE:
        if canvas is None or canvas.size != full_size:
            canvas = Image.new("RGB", full_size)
        canvas.paste(picture_of(header, payload), (header.x, header.y))
    return canvas  # Other kinds come from later servers: acknowledged and ignored.


def first_scene(server):
    """Id of the first scene that the server lists."""
    with urllib.request.urlopen(f"{server}/v1/scenes", timeout=10) as answer:
        scenes = json.load(answer)["scenes"]
    if not scenes:
        raise Refused(f"{server} has no scene")
    return scenes[0]["id"]


def watch(socket, options):
    """Talks to the server until enough frames have come and the edit is seen; returns the last picture."""

    def say(**message):
        socket.send(json.dumps(message))

    say(type="hello", client="example_client.py", version="1")
    say(type="quality", codec=options.codec)
    edit = options.edit and json.load(open(options.edit, encoding="utf-8"))
    # Done once a picture of this revision has been seen: with an edit, the one it makes.
    wanted = math.inf if edit else 0
    canvas, frames, revision, sent_at = None, 0, 0, 0.0
    while frames < options.frames or revision < wanted:
        message = socket.recv(timeout=options.timeout)
        if isinstance(message, bytes):
            header, payload = split_frame(message)
            canvas = show(canvas, header, payload)
            say(type="ack", frame=header.frame)
            frames, revision = frames + 1, header.revision
            # Only the first frame drawn from a camera message tells how long the way from hand to eye is.
            latency = f"{1000 * (time.monotonic() - sent_at):.1f} ms" if header.flags & 2 else "-"
            error = "-" if header.error < 0 else f"{100 * header.error:.2f} %"
            state = " converged" if header.flags & 1 else ""
            print(f"frame {header.frame} revision {header.revision} size {header.width}x{header.height}"
                  f" samples {header.samples} error {error} latency {latency}{state}", flush=True)
            if frames == 1 and edit:
                say(type="edit", request=1, edits=edit["edits"] if isinstance(edit, dict) else edit)
            if state and revision >= wanted:
                break  # A converged picture rests: no more frames will come.
            continue
        message = json.loads(message)
        if message["type"] == "hello":
            print(f"connected to scene {message['scene']} at revision {message['revision']}", flush=True)
        elif message["type"] == "scene" and sent_at == 0.0:
            cameras = [camera["id"] for camera in message["scene"]["cameras"]]
            if not options.camera and not cameras:
                raise Refused("the scene has no camera; this example needs one (see set_camera)")
            sent_at = time.monotonic()
            say(type="camera", stamp=1, size=options.size, camera=options.camera or cameras[0])
        elif message["type"] == "edited":
            wanted = message["revision"]
            print(f"edit made revision {message['revision']}", flush=True)
        elif message["type"] == "error":
            problem = message["problem"]
            raise Refused(f"{problem['title']} ({problem['status']}): {problem.get('detail', '')}")
    return canvas


def size(text):
    width, _, height = text.partition("x")
    return [int(width), int(height)]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("server", nargs="?", default="http://127.0.0.1:7171")
    parser.add_argument("--scene", help="id of the scene; the first one if absent")
    parser.add_argument("--camera", help="id of a camera of the scene; its first one if absent")
    parser.add_argument("--size", type=size, default=[640, 360], metavar="WxH")
    parser.add_argument("--frames", type=int, default=10, help="stop after this many, or when converged")
    parser.add_argument("--codec", choices=["auto", "jpeg", "png", "float"], default="auto")
    parser.add_argument("--edit", metavar="FILE.json", help="edits to send after the first frame")
    parser.add_argument("--out", metavar="PICTURE.png", help="where to save the last picture")
    parser.add_argument("--timeout", type=float, default=30.0, help="seconds to wait for a message")
    options = parser.parse_args()
    try:
        from websockets.exceptions import InvalidStatus, WebSocketException
        from websockets.sync.client import connect
    except ImportError as error:
        sys.exit(f"{error}: pip install websockets pillow")
    server = options.server.rstrip("/")
    try:
        url = f"ws{server[4:]}/v1/scenes/{options.scene or first_scene(server)}/ws"
        # A float picture is larger than the 1 MiB that the library allows by default.
        bytes_max = HEADER.size + 12 * math.prod(options.size) + (1 << 24)
        with connect(url, subprotocols=["lumicast.v1"], max_size=bytes_max) as socket:
            if socket.subprotocol != "lumicast.v1":
                raise Refused(f"{url} does not speak lumicast.v1")
            canvas = watch(socket, options)
        if options.out and canvas is not None:
            canvas.save(options.out)
            print(f"saved {options.out}")
    except InvalidStatus as error:
        # The reason is a problem document [RFC 9457], unless something else than Lumicast answered.
        try:
            reason = json.loads(error.response.body)["detail"]
        except (ValueError, KeyError, TypeError):
            reason = error
        sys.exit(f"example_client.py: {url}: {error.response.status_code}: {reason}")
    except (Refused, OSError, ValueError, KeyError, WebSocketException, urllib.error.URLError) as error:
        sys.exit(f"example_client.py: {type(error).__name__}: {error}")


if __name__ == "__main__":
    main()
