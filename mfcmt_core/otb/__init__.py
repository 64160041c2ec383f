"""Evaluation on OTB and its relatives: data sets, OPE / TRE / SRE, scores, result files and reports.

data = open_dataset(Path("otb"))
default, = evaluate(data, [Engine("default", MFCMTConfig.default())], "OPE", results=Path("results"))
print(default.success, default.precision, default.fps)
print(score(data, {"David": boxes}).success)      # boxes of your own, (N, 4), 0-based
"""

from ..errors import DataError
from .dataset import ATTRIBUTES, Dataset, Sequence, open_otb, otb_targets, read_boxes
from .layouts import open_dataset
from .protocol import PROTOCOLS, Run, ope, sre, tre
from .results import ResultStore, read_result, write_boxes
from .runner import evaluate
from .score import Evaluation, SequenceScore, Speed, score, score_runs
from .trackers import Engine, Entry, ResultFolder, Tracker, code_hash

__all__ = [
    "ATTRIBUTES",
    "PROTOCOLS",
    "DataError",
    "Dataset",
    "Engine",
    "Entry",
    "Evaluation",
    "ResultFolder",
    "ResultStore",
    "Run",
    "Sequence",
    "SequenceScore",
    "Speed",
    "Tracker",
    "code_hash",
    "evaluate",
    "ope",
    "open_dataset",
    "open_otb",
    "otb_targets",
    "read_boxes",
    "read_result",
    "score",
    "score_runs",
    "sre",
    "tre",
    "write_boxes",
]
