"""Write what was tracked: as rows while tracking goes on, or as a document in the form of another tool."""

from .rows import Clip, Row, Target
from .writers import FORMATS, SUFFIXES, Options, Writer, open_writer

__all__ = ["FORMATS", "SUFFIXES", "Clip", "Options", "Row", "Target", "Writer", "open_writer"]
