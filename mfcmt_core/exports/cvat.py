"""CVAT for video 1.1: an XML with a track a target and a box a keyframe, between which CVAT interpolates."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree as ET  # it only writes here

from .paths import points
from .rows import Clip, Row, by_target


def cvat(clip: Clip, rows: Iterable[Row], tolerance: float, length: int) -> bytes:
    """Return the document. ``length`` is the number of frames; boxes are clipped to the frame.

    The label is the target's class, its name an attribute.
    """
    tracks = by_target(rows)
    root = ET.Element("annotations")
    _text(root, "version", "1.1")
    task = ET.SubElement(ET.SubElement(root, "meta"), "task")
    _text(task, "name", clip.name)
    _text(task, "size", length)
    _text(task, "mode", "interpolation")
    _text(task, "start_frame", 0)
    _text(task, "stop_frame", max(0, length - 1))
    labels = ET.SubElement(task, "labels")
    for kind in dict.fromkeys(target.kind for target in tracks):
        label = ET.SubElement(labels, "label")
        _text(label, "name", kind)
        attribute = ET.SubElement(ET.SubElement(label, "attributes"), "attribute")
        for name, value in (("name", "name"), ("mutable", "False"), ("input_type", "text")):
            _text(attribute, name, value)
        _text(attribute, "default_value", "")
        _text(attribute, "values", "")
    size = ET.SubElement(task, "original_size")
    _text(size, "width", clip.width)
    _text(size, "height", clip.height)
    _text(task, "source", clip.name)
    for target, path in tracks.items():
        track = ET.SubElement(root, "track", id=str(target.id - 1), label=target.kind, source="auto")
        last = None
        for last in points(clip, path, tolerance):
            _box(track, last.frame, last.box, target.name, outside=not last.present)
        if last is not None and last.present and path[-1].frame < length - 1:  # a track that ends before the clip
            _box(track, path[-1].frame + 1, last.box, target.name, outside=True)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'.encode()


def _box(track: ET.Element, frame: int, box: tuple[float, ...], name: str, *, outside: bool) -> None:
    x, y, w, h = box
    edges = {"xtl": x, "ytl": y, "xbr": x + w, "ybr": y + h}
    about = {"frame": str(frame), "keyframe": "1", "outside": str(int(outside)), "occluded": "0"}
    element = ET.SubElement(track, "box", about | {k: f"{v:.2f}" for k, v in edges.items()} | {"z_order": "0"})
    ET.SubElement(element, "attribute", name="name").text = name


def _text(parent: ET.Element, name: str, value: object) -> None:
    ET.SubElement(parent, name).text = str(value)
