"""PNG files: label maps, in which a pixel's value is its layer's id, and pictures with opacity."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np

from mlbs_actors.messages import Array

__all__ = ["LARGEST_INDEXED_LABEL", "davis_palette", "encode_label_image", "encode_picture", "voc_colours"]

#: Larger ids are stored in 16-bit grey; 255 is left out because it means "ignore" in DAVIS and PASCAL VOC.
LARGEST_INDEXED_LABEL = 254

_DAVIS_COLOURS = 22  # from here on its palette is a grey ramp

# Label maps are large flat areas: a higher level takes longer and saves nothing, as repeated bytes are all
# the redundancy there is.
_COMPRESSION, _STRATEGY = 1, zlib.Z_RLE
_MEMORY = 5  # of 9; more saves nothing, and takes a quarter longer
_GREY, _INDEXED = 0, 3  # PNG's kinds of colour
_UNFILTERED = 0  # PNG's word before a row


def voc_colours(count: int = 256) -> Array:
    """Return the PASCAL VOC palette: the bits of an index, three at a time, from the highest bit down.

    Parameters
    ----------
    count : int
        1 … 256.

    Returns
    -------
    (count, 3) uint8, RGB
    """
    index = np.arange(count, dtype=np.int64)
    colours = np.zeros((count, 3), np.int64)
    for level in range(8):
        bits = np.stack([index >> (3 * level + channel) & 1 for channel in range(3)], axis=1)
        colours |= bits << (7 - level)
    return colours.astype(np.uint8)


def davis_palette() -> Array:
    """Return the palette of the DAVIS masks: that of VOC with 191 for 192, then from 22 on a grey ramp.

    Returns
    -------
    (256, 3) uint8, RGB
    """
    palette = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
    palette[:_DAVIS_COLOURS] = np.where(voc_colours(_DAVIS_COLOURS) == 192, 191, voc_colours(_DAVIS_COLOURS))
    return palette


_PALETTE_BYTES = davis_palette().tobytes()


def encode_label_image(labels: Array) -> bytes:
    """Encode a label map: indexed with the DAVIS palette, or 16-bit grey past id 254.

    Parameters
    ----------
    labels : (H, W) uint16

    Returns
    -------
    bytes
        A PNG file; the same map gives the same bytes.
    """
    height, width = labels.shape
    indexed = labels.max(initial=0) <= LARGEST_INDEXED_LABEL
    sample, colour = (np.dtype(np.uint8), _INDEXED) if indexed else (np.dtype(">u2"), _GREY)
    # Written here, as an image library's many small steps take as long again as the compression.
    rows: Array = np.empty((height, 1 + width * sample.itemsize), np.uint8)
    rows[:, 0] = _UNFILTERED
    rows[:, 1:].view(sample)[:] = labels
    deflate = zlib.compressobj(_COMPRESSION, memLevel=_MEMORY, strategy=_STRATEGY)
    chunks = (
        _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8 * sample.itemsize, colour, 0, 0, 0)),
        _chunk(b"PLTE", _PALETTE_BYTES) if indexed else b"",
        _chunk(b"IDAT", deflate.compress(rows.data) + deflate.flush()),
        _chunk(b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def _chunk(kind: bytes, content: bytes) -> bytes:
    """Return a chunk of a PNG file, with its length and its checksum."""
    check = zlib.crc32(content, zlib.crc32(kind))
    return len(content).to_bytes(4, "big") + kind + content + check.to_bytes(4, "big")


def encode_picture(picture: Array) -> bytes:
    """Encode a picture, (H, W, 4) uint8 BGR and opacity, as PNG; the same picture gives the same bytes."""
    _, encoded = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, _COMPRESSION])
    return bytes(encoded.tobytes())
