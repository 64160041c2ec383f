"""Trackers by name, by file and by folder."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pytest

from mfcmt_core import MFCMTConfig
from mfcmt_core.otb import DataError, Engine, ResultFolder, code_hash
from mfcmt_core.otb.catalogue import ABLATIONS, CHOICES, SYSTEMS, resolve
from mfcmt_core.otb.peers import PEERS, Peer
from mfcmt_core.otb.trackers import identity_hash


def engine(text: str) -> Engine:
    entry = resolve(text)
    assert isinstance(entry, Engine)
    return entry


def test_a_preset_is_found_by_its_name_and_takes_a_label() -> None:
    assert engine("default").config == MFCMTConfig.default()
    assert engine("paper").config == MFCMTConfig.paper()
    assert engine("mine=paper").name == "mine"


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_papers_rivals_learn_every_frame_and_search_no_whole_frame(name: str) -> None:
    config = engine(name).config
    assert config.search_after == 0
    assert config.fused_threshold == config.template_threshold == config.statistical_threshold == 0
    assert config.lost_after == 0
    assert config.color_histogram == (name in ("staple", "dat"))
    assert (config.num_scales == 33) == (name in ("staple", "samf", "dsst"))
    assert config.scale_samples == 33
    assert config.scale_interval == 1
    assert config.scale_max_area == 512
    assert config.learn_within == 0


@pytest.mark.parametrize(("name", "maps"), [("default-fixed-merge", 2), ("paper-fixed-merge", 3)])
def test_the_fixed_merge_gives_the_histogram_three_parts_in_ten(name: str, maps: int) -> None:
    weight = engine(name).config.statistical_weight
    assert weight / (maps + weight) == pytest.approx(0.3)


def test_staple_merges_three_parts_in_ten_of_the_histogram() -> None:
    config = engine("staple").config
    assert config.probability == "raw"
    assert config.statistical_weight / (1 + config.statistical_weight) == pytest.approx(0.3)
    assert config.features == ("fhog",)


@pytest.mark.parametrize("preset", ["default", "paper"])
@pytest.mark.parametrize("name", ABLATIONS)
def test_an_ablation_changes_what_it_says_and_nothing_else(preset: str, name: str) -> None:
    changed, base = engine(f"{preset}-{name}").config.to_dict(), MFCMTConfig.preset(preset).to_dict()
    assert {k for k in base if changed[k] != base[k]} <= set(ABLATIONS[name])
    assert changed != base


@pytest.mark.parametrize("name", CHOICES)
def test_a_choice_of_default_goes_back_to_the_papers_way(name: str) -> None:
    changed, base = engine(f"default-{name}").config.to_dict(), MFCMTConfig.default().to_dict()
    paper = MFCMTConfig.paper().to_dict()
    differing = {k for k in base if changed[k] != base[k]} - {"statistical_weight"}
    assert all(changed[k] == paper[k] for k in differing)
    assert changed != base


def test_a_configuration_file_changes_its_base(tmp_path: Path) -> None:
    path = tmp_path / "slow.toml"
    path.write_text('base = "paper"\ntemplate_learning_rate = 0.005\nfeatures = ["gray", "fhog"]\n')
    entry = engine(str(path))
    assert entry.name == "slow"
    assert entry.config == MFCMTConfig.paper().replace(template_learning_rate=0.005, features=("gray", "fhog"))
    path = tmp_path / "same.json"
    path.write_text(json.dumps(MFCMTConfig.paper().to_dict()))
    assert engine(str(path)).config == MFCMTConfig.paper()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("template_learning_rate = 7", "template_learning_rate"),
        ("learnrate = 1", "learnrate"),
        ("base = 'best'", "base is not a name"),
        ("a = ", "Invalid value"),
    ],
)
def test_a_bad_configuration_file_is_named(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(DataError, match=says) as caught:
        resolve(str(path))
    assert str(path) in str(caught.value)


def test_a_folder_is_taken_as_results_and_an_unknown_name_is_refused(tmp_path: Path) -> None:
    assert resolve(str(tmp_path)) == ResultFolder(tmp_path.name, tmp_path)
    assert resolve(f"KCF={tmp_path}").name == "KCF"
    with pytest.raises(DataError, match="no tracker 'best'"):
        resolve("best")


@pytest.mark.parametrize("name", PEERS)
def test_a_peer_without_its_library_takes_part_by_its_results(name: str, tmp_path: Path) -> None:
    lacks = Peer(name, name).lacks
    if lacks is None:
        assert isinstance(resolve(name), Peer)
        return
    with pytest.raises(DataError, match=re.escape(lacks)):
        resolve(name, tmp_path)
    (tmp_path / "OPE" / name).mkdir(parents=True)
    entry = resolve(name, tmp_path)
    assert isinstance(entry, ResultFolder)
    assert entry.under("OPE").folder == tmp_path / "OPE" / name


def test_identity_follows_code_and_configuration() -> None:
    one, other = engine("default").identity, engine("paper").identity
    assert one["code"] == other["code"] == code_hash()
    assert identity_hash(one) != identity_hash(other)
    assert identity_hash(one) == identity_hash(json.loads(json.dumps(one)))


def test_comments_and_docstrings_do_not_change_the_hash() -> None:
    from mfcmt_core.otb.trackers import _WithoutStrings

    def dump(source: str) -> str:
        return ast.dump(_WithoutStrings().visit(ast.parse(source)))

    assert dump('"""A."""\nx: int = 1  # one\n"""Note."""') == dump("x: int = 1")
    assert dump("x = 1") != dump("x = 2")
