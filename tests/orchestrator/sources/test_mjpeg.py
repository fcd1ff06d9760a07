"""Cameras that send JPEGs over HTTP: in whatever frame, one by one, behind passwords; and who is none."""

from __future__ import annotations

import hashlib
from base64 import b64encode
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler
from itertools import islice
from pathlib import Path
from urllib.request import parse_http_list, parse_keqv_list

import cv2
import numpy as np
import pytest
from web_server import Page, page, web_server

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from orchestrator.sources import mjpeg
from orchestrator.sources.address import parse_address
from orchestrator.sources.connection import connect
from orchestrator.sources.http_answer import HttpCamera
from orchestrator.sources.jpeg import JpegFinder
from orchestrator.sources.live_buffer import Picture


def jpeg(shade: int) -> bytes:
    noise = np.random.default_rng(shade).integers(-20, 20, (48, 64, 3))
    return cv2.imencode(".jpg", np.clip(noise + shade, 0, 255).astype(np.uint8))[1].tobytes()


PICTURES = [jpeg(50 + 40 * number) for number in range(5)]
PARTS = [b"--frame\r\nContent-Type: image/jpeg\r\n\r\n" + one + b"\r\n" for one in PICTURES]


def pictures_at(url: str) -> Iterator[Picture | None]:
    connection = connect(parse_address(url, Path("/")))
    try:
        yield from connection.pictures()
    finally:
        connection.close()


def numbers(pictures: Iterator[Picture | None], count: int) -> list[int | None]:
    """Numbers of so many of PICTURES, None for a damaged one; signs of life are left out."""
    shown = (picture.convert() for picture in pictures if picture is not None)
    return [None if image is None else round((np.mean(image) - 50) / 40) for image in islice(shown, count)]


# Bytes


@pytest.mark.parametrize("length", [1, 2, 3, 7, 100, 1 << 20])
def test_pictures_are_found_however_the_bytes_are_cut_and_whatever_is_between(length: int) -> None:
    data = b"no picture \xff\xd8 yet \xff".join([b"", *PICTURES])
    finder = JpegFinder()
    found = [one for at in range(0, len(data), length) for one in finder.feed(data[at : at + length])]
    assert found == PICTURES


def test_a_thumbnail_is_part_of_its_picture() -> None:
    note = b"\xff\xe1" + (len(PICTURES[0]) + 2).to_bytes(2, "big") + PICTURES[0]
    whole = PICTURES[1][:2] + note + PICTURES[1][2:]
    assert list(JpegFinder().feed(whole + PICTURES[2])) == [whole, PICTURES[2]]


def test_a_picture_that_the_next_cuts_off_is_one_and_so_is_what_never_ends() -> None:
    half = PICTURES[0][: len(PICTURES[0]) * 2 // 3]
    assert list(JpegFinder().feed(half + PICTURES[1])) == [half, PICTURES[1]]
    finder = JpegFinder(most_bytes=5000)
    endless = [len(one) for _ in range(20) for one in finder.feed((half + bytes(1000))[:1000])]
    assert endless
    assert max(endless) <= 6000


def test_random_damage_costs_few_pictures_and_never_the_place() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        damaged = bytearray(PICTURES[0])
        damaged[rng.integers(2, len(damaged))] ^= 1 << rng.integers(8)
        # A wrong length of a segment reaches 64 KB far.
        found = list(JpegFinder().feed(bytes(damaged) + PICTURES[1] * 200 + PICTURES[2] * 2))
        assert found[-1] == PICTURES[2]


# Streams


@pytest.mark.parametrize(
    ("content_type", "pieces"),
    [
        ("multipart/x-mixed-replace; boundary=frame", PARTS),
        ("multipart/x-mixed-replace;boundary=--frame", [PARTS[0].partition(b"\r\n\r\n")[2], *PARTS[1:]]),
        ("multipart/x-mixed-replace", [b"\r\n" + part for part in PARTS]),
        ("Image/JPEG", PICTURES),
        ("video/x-motion-jpeg", PICTURES),
        ("application/octet-stream", PICTURES),
        (None, PARTS),
    ],
)
def test_a_row_of_jpegs_is_read_whatever_its_frame(content_type: str | None, pieces: list[bytes]) -> None:
    with web_server({"/v": page(content_type, *pieces)}) as host:
        assert numbers(pictures_at(f"http://{host}/v"), 9) == [0, 1, 2, 3, 4]


def test_a_damaged_picture_is_one_without_an_image_and_the_next_is_whole() -> None:
    cut = PICTURES[1][: len(PICTURES[1]) // 2]
    pieces = [PICTURES[0], cut, PICTURES[2], b"\xff\xd8\xff\xe0\x00\x04no\xff\xd9", PICTURES[3]]
    with web_server({"/v": page("image/jpeg", *pieces)}) as host:
        assert numbers(pictures_at(f"http://{host}/v"), 9) == [0, None, 2, None, 3]


def test_a_picture_is_turned_as_its_camera_states() -> None:
    image = np.zeros((24, 32, 3), np.uint8)
    image[:8, :8] = 255
    plain = cv2.imencode(".jpg", image)[1].tobytes()
    tiff = b"MM\x00*\x00\x00\x00\x08\x00\x01\x01\x12\x00\x03\x00\x00\x00\x01\x00\x06\x00\x00\x00\x00\x00\x00"
    exif = b"Exif\x00\x00" + tiff
    turned = plain[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + plain[2:]
    with web_server({"/v": page("multipart/x-mixed-replace", turned, turned)}) as host:
        first = next(pictures_at(f"http://{host}/v"))
    assert first is not None
    shown: Array | None = first.convert()
    assert shown is not None
    assert shown.shape == (32, 24, 3)
    assert int(shown[0, -1, 0]) > 200


# Single pictures


def test_a_single_picture_is_fetched_again_and_again_and_an_old_one_is_told_as_a_sign_of_life(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(mjpeg, "_POLL_SECONDS", 0.01)
    sent = iter([0, 1, 1, 2, 3, 4])
    with web_server({"/p": lambda request: page("image/jpeg", PICTURES[next(sent)])(request)}) as host:
        got = list(islice(pictures_at(f"http://{host}/p"), 6))
    assert [one is None for one in got] == [False, False, True, False, False, False]
    assert numbers(iter(got), 9) == [0, 1, 2, 3, 4]


def test_a_camera_that_names_the_version_of_its_picture_is_asked_for_newer_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(mjpeg, "_POLL_SECONDS", 0.01)
    asked: list[tuple[str | None, str | None]] = []

    def picture(request: BaseHTTPRequestHandler) -> None:
        known = request.headers["If-None-Match"], request.headers["If-Modified-Since"]
        asked.append(known)
        if known[0] == '"1"' and len(asked) < 4:
            page(None, status=304)(request)
        else:
            page("image/jpeg", jpeg(len(asked)), ETag='"1"', Last_Modified="Mon")(request)

    with web_server({"/p": picture}) as host:
        got = list(islice(pictures_at(f"http://{host}/p"), 4))
    assert [one is None for one in got] == [False, True, True, False]
    assert asked[:4] == [(None, None), *[('"1"', "Mon")] * 3]


def test_pauses_between_requests_are_short_and_grow_while_nothing_is_new() -> None:
    pauses: list[float] = []
    with web_server({"/p": page("image/jpeg", PICTURES[1])}) as host:
        camera = HttpCamera(f"http://{host}/p", 10.0)
        answer = camera.get()
        assert answer is not None
        connection = mjpeg.JpegConnection(
            camera, answer, b"", patience_s=10.0, clock=lambda: 0.0, sleep=pauses.append
        )
        list(islice(connection.pictures(), 8))
        connection.close()
    assert pauses == pytest.approx([0.2, 0.4, 0.8, 1.6, 2.0, 2.0, 2.0])


# Passwords


def _basic(known: Page) -> Page:
    login = "Basic " + b64encode(b"bob:a/b:%").decode()
    refuse = page(None, status=401, WWW_Authenticate='Basic realm="camera"')
    return lambda request: (known if request.headers["Authorization"] == login else refuse)(request)


def _digest(known: Page, hash_name: str, asked: list[str]) -> Page:
    def hashed(text: str) -> str:
        return hashlib.new(hash_name.replace("-", ""), text.encode()).hexdigest()

    def answer(request: BaseHTTPRequestHandler) -> None:
        given = request.headers["Authorization"] or ""
        asked.append(given)
        fields = parse_keqv_list(parse_http_list(given.partition(" ")[2]))
        secret, what = hashed("bob:camera:a/b:%"), hashed(f"GET:{request.path}")
        middle = ":".join(fields.get(name, "") for name in ("nonce", "nc", "cnonce", "qop"))
        if fields.get("response") == hashed(f"{secret}:{middle}:{what}"):
            known(request)
            return
        request.send_response(401)
        request.send_header("WWW-Authenticate", 'Digest realm="camera", nonce="7", algorithm=SHA-512-256')
        request.send_header(
            "WWW-Authenticate",
            f'Digest realm="camera", nonce="7", qop="auth", opaque=, algorithm={hash_name}',
        )
        request.end_headers()

    return answer


@pytest.mark.parametrize("kind", ["basic", "MD5", "SHA-256"])
def test_a_password_is_sent_as_the_camera_wants_it(kind: str) -> None:
    video = page("multipart/x-mixed-replace", *PARTS)
    pages = {"/v": _basic(video) if kind == "basic" else _digest(video, kind, [])}
    with web_server(pages) as host:
        assert numbers(pictures_at(f"http://bob:a%2Fb%3A%25@{host}/v?x=1"), 9) == [0, 1, 2, 3, 4]


def test_a_wrong_password_is_sent_once_and_never_shown() -> None:
    asked: list[str] = []
    with (
        web_server({"/v": _digest(page("image/jpeg", PICTURES[0]), "MD5", asked)}) as host,
        pytest.raises(SourceError, match=r"user name or password refused .*\.$") as caught,
    ):
        next(pictures_at(f"http://bob:hunter2@{host}/v"))
    assert [bool(one) for one in asked] == [False, True]
    assert "hunter2" not in f"{caught.value!r} {caught.value.__cause__!r}"


def test_a_password_does_not_follow_to_another_host() -> None:
    given: list[str | None] = []

    def other(request: BaseHTTPRequestHandler) -> None:
        given.append(request.headers["Authorization"])
        page(None, status=401, WWW_Authenticate='Basic realm="camera"')(request)

    with web_server({"/v": other}) as thief:
        away = page(None, status=302, Location=f"http://{thief}/v")
        with web_server({"/v": _basic(away)}) as host, pytest.raises(SourceError, match="refused"):
            next(pictures_at(f"http://bob:a%2Fb%3A%25@{host}/v"))
    assert given == [None]


# Who is no camera


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        (
            page("text/html; charset=utf-8", b"<html>"),
            r"something of the type 'text/html'; over HTTP are read",
        ),
        (page("video/mp4", b"1234", Content_Length="4"), "a finished video, no camera; download it"),
        (page(None, status=404), "nothing at this path"),
        (page(None, status=403), "give them the right in the camera"),
        (page(None, status=500), "answers with the error 500"),
        (page(None, status=302, Location="file:///etc/passwd"), "answers with the error 302"),
        (page(None, status=302, Location="ftp://127.0.0.1/x"), "it cannot be reached"),
        (page("image/jpeg"), "its answer holds no whole JPEG"),
        (page("image/jpeg", PICTURES[0][:300]), "its answer holds no whole JPEG"),
    ],
)
def test_what_is_no_camera_is_told_in_a_sentence(answer: Page, told: str) -> None:
    with web_server({"/x": answer}) as host, pytest.raises(SourceError, match=told):
        next(pictures_at(f"http://{host}/x"))


def test_nobody_at_a_port_is_told_with_what_to_check() -> None:
    with pytest.raises(SourceError, match="Connection refused; check the port, and whether the camera is on"):
        next(pictures_at("http://127.0.0.1:9/x"))


def test_a_host_that_nobody_knows_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("no_proxy", "*")
    with pytest.raises(SourceError, match="its host is unknown; check the name"):
        next(pictures_at("http://camera.invalid/x"))


def test_a_camera_on_this_machine_is_not_asked_for_through_a_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    with web_server({"/v": page("multipart/x-mixed-replace", *PARTS)}) as host:
        assert numbers(pictures_at(f"http://{host}/v"), 2) == [0, 1]
