"""Matroska files as the recorder of the Azure Kinect writes them, from the format's own elements."""

import struct

_IDS = {
    "EBML": "1A45DFA3", "EBMLVersion": "4286", "EBMLReadVersion": "42F7", "EBMLMaxIDLength": "42F2",
    "EBMLMaxSizeLength": "42F3", "DocType": "4282", "DocTypeVersion": "4287", "DocTypeReadVersion": "4285",
    "Segment": "18538067", "Info": "1549A966", "TimestampScale": "2AD7B1", "MuxingApp": "4D80",
    "WritingApp": "5741", "Tracks": "1654AE6B", "TrackEntry": "AE", "TrackNumber": "D7", "TrackUID": "73C5",
    "TrackType": "83", "FlagLacing": "9C", "Name": "536E", "CodecID": "86", "CodecPrivate": "63A2",
    "Video": "E0", "PixelWidth": "B0", "PixelHeight": "BA", "Attachments": "1941A469", "AttachedFile": "61A7",
    "FileName": "466E", "FileMimeType": "4660", "FileData": "465C", "FileUID": "46AE", "Cluster": "1F43B675",
    "Timestamp": "E7", "SimpleBlock": "A3",
}  # fmt: skip


def element(name, content):
    """An element of bytes, a text, a number or a list of elements."""
    if isinstance(content, int):
        content = content.to_bytes(max(1, (content.bit_length() + 7) // 8), "big")
    elif isinstance(content, str):
        content = content.encode()
    elif isinstance(content, list):
        content = b"".join(content)
    return bytes.fromhex(_IDS[name]) + (len(content) | 1 << 56).to_bytes(8, "big") + content


def write_recording(path, tracks, attachments, stop=None):
    """Write tracks, {name: [(microseconds, (H, W) uint16 frame), ...]}, and attachments, {name: bytes}."""
    head = {"EBMLVersion": 1, "EBMLReadVersion": 1, "EBMLMaxIDLength": 4, "EBMLMaxSizeLength": 8}
    head |= {"DocType": "matroska", "DocTypeVersion": 4, "DocTypeReadVersion": 2}
    entries, blocks = [], []
    for number, (name, frames) in enumerate(tracks.items(), start=1):
        height, width = frames[0][1].shape
        bitmap = struct.pack("<IiiHH4sIiiII", 40, width, height, 1, 16, b"b16g", 2 * width * height, 0, 0, 0, 0)
        about = {"TrackNumber": number, "TrackUID": number, "TrackType": 1, "FlagLacing": 0, "Name": name}
        about |= {"CodecID": "V_MS/VFW/FOURCC", "CodecPrivate": bitmap}
        video = element("Video", [element("PixelWidth", width), element("PixelHeight", height)])
        entries.append(element("TrackEntry", [*(element(k, v) for k, v in about.items()), video]))
        blocks += [(time, number, frame.astype(">u2").tobytes()) for time, frame in frames]
    files = [
        element(
            "AttachedFile",
            [
                element("FileName", name),
                element("FileMimeType", "application/octet-stream"),
                element("FileData", content),
                element("FileUID", 1000 + i),
            ],
        )
        for i, (name, content) in enumerate(attachments.items())
    ]
    clusters = [
        element(
            "Cluster",
            [element("Timestamp", time), element("SimpleBlock", bytes([0x80 | number]) + b"\0\0\x80" + content)],
        )
        for time, number, content in sorted(blocks)
    ]
    info = [element("TimestampScale", 1000), element("MuxingApp", "test"), element("WritingApp", "test")]
    segment = [element("Info", info), element("Tracks", entries), element("Attachments", files), *clusters]
    header = element("EBML", [element(name, value) for name, value in head.items()])
    path.write_bytes((header + element("Segment", segment))[:stop])
