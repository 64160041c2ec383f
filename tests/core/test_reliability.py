"""The three tests of section III-C against the last ten frames, and the status that follows from them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfcmt_core import MFCMTConfig
from mfcmt_core.reliability import Peaks, Reliability

PAPER = MFCMTConfig.paper()
PEAK = st.floats(1e-6, 1e3)


def after(history, config=PAPER) -> Reliability:
    """Return a Reliability that judged frames with these peaks and learned the reliable ones."""
    judge = Reliability(config)
    for peaks in history:
        judge_frame(judge, peaks)
    return judge


def judge_frame(judge, peaks):
    peaks = Peaks(*peaks)
    verdict = judge.judge(peaks, 1.0)
    if verdict.reliable:
        judge.record_learned(peaks)
    return verdict


@pytest.mark.parametrize(
    ("factors", "flags"),
    [
        ((0.51, 0.71, 0.51), (True, True, True)),
        ((0.49, 0.71, 0.51), (False, True, True)),
        ((0.51, 0.69, 0.51), (True, False, True)),
        ((0.51, 0.71, 0.49), (True, True, False)),
        ((0.1, 0.1, 0.1), (False, False, False)),
        ((0.5, 1, 1), (False, True, True)),  # greater than, not equal
    ],
)
def test_each_peak_is_tested_against_its_threshold_of_the_paper(factors, flags):
    """They are γ_q = 0.5, γ_t = 0.7 and γ_s = 0.5 times the mean of ten peaks; a reliable frame passes all."""
    mean = (0.25, 0.5, 0.75)
    verdict = judge_frame(after([mean] * 10), np.multiply(mean, factors).tolist())
    assert (verdict.flags.fused, verdict.flags.template, verdict.flags.statistical) == flags
    assert verdict.reliable == all(flags)
    scores = (verdict.scores.fused, verdict.scores.template, verdict.scores.statistical)
    assert scores == pytest.approx(factors)
    assert verdict.status == ("tracking" if all(flags) else "uncertain")


@settings(max_examples=60)
@given(st.lists(st.tuples(PEAK, PEAK, PEAK), min_size=1, max_size=25), st.tuples(PEAK, PEAK, PEAK))
def test_scores_are_ratios_to_the_mean_of_the_last_ten_frames_reliable_or_not(history, now):
    verdict = judge_frame(after(history), now)
    expected = np.array(now) / np.mean(history[-10:], axis=0)
    scores = (verdict.scores.fused, verdict.scores.template, verdict.scores.statistical)
    assert scores == pytest.approx(expected.tolist(), rel=1e-6)
    assert (
        verdict.reliable == bool((expected > (0.5, 0.7, 0.5)).all())
        or np.isclose(expected, (0.5, 0.7, 0.5), rtol=1e-6).any()
    )


def test_the_first_frame_is_reliable_and_has_scores_of_one():
    verdict = judge_frame(Reliability(PAPER), (0.1, 0.2, 0.3))
    assert verdict.reliable
    assert verdict.scores == type(verdict.scores)(1, 1, 1)


def test_a_frame_after_ten_empty_ones_is_reliable():
    judge = after([(0, 0, 0)] * 10)
    assert judge_frame(judge, (0, 0, 0)).reliable
    verdict = judge_frame(judge, (0.1, 0.2, 0.3))
    assert verdict.reliable
    assert np.isfinite([verdict.scores.fused, verdict.scores.template, verdict.scores.statistical]).all()


def test_with_the_paper_s_rule_ten_bad_frames_become_the_new_measure():
    """The long-term means are there to prevent this."""
    judge = after([(1, 1, 1)] * 10)
    reliable = [judge_frame(judge, (0.3, 0.3, 0.3)).reliable for _ in range(10)]
    assert not reliable[0]
    assert reliable[-1]


def test_a_target_is_lost_after_lost_after_unreliable_frames():
    config = PAPER.replace(lost_after=3)
    judge = after([(1, 1, 1)] * 10, config)
    # each half of the last, so that the sinking mean does not make it reliable
    statuses = [judge_frame(judge, (1, 0.5**k, 1)).status for k in range(1, 8)]
    assert statuses[:3] == ["uncertain", "uncertain", "lost"]
    assert judge.lost
    assert statuses[3:] == ["lost"] * 4


def test_a_target_is_never_lost_if_lost_after_is_zero():
    judge = after([(1, 1, 1)] * 10, PAPER.replace(lost_after=0))
    assert {judge_frame(judge, (1, 0.5**k, 1)).status for k in range(1, 100)} == {"uncertain"}


def test_a_lost_target_is_found_when_both_peaks_are_near_their_long_term_means():
    config = PAPER.replace(lost_after=3, found_threshold=0.6)
    judge = after([(1, 1, 1)] * 20, config)
    for k in range(1, 7):
        judge_frame(judge, (1, 0.5**k, 1))
    assert judge.lost
    verdict = judge_frame(judge, (1, 0.59, 1))  # high against the last ten frames, low against the long-term mean
    assert verdict.flags.template
    assert (verdict.status, verdict.reliable) == ("lost", False)
    verdict = judge_frame(judge, (1, 0.9, 0.59))  # the colors do not match
    assert (verdict.status, verdict.reliable) == ("lost", False)
    verdict = judge_frame(judge, (1, 0.9, 1))
    assert (verdict.status, verdict.reliable) == ("tracking", True)
    assert not judge.lost
    assert judge.unreliable_run == 0


@pytest.mark.parametrize("cue", [1, 2])
def test_usual_threshold_keeps_frames_unreliable_while_the_ten_frame_mean_sinks(cue):
    """This holds for the template peak and for the statistical one."""
    judge = after([(1, 1, 1)] * 20, PAPER.replace(usual_threshold=0.5))

    def peaks(height):
        return [height if k == cue else 1 for k in range(3)]

    assert not any(judge_frame(judge, peaks(0.3)).reliable for _ in range(40))
    assert judge_frame(judge, peaks(0.6)).reliable


def test_long_term_means_count_learned_frames_only():
    judge = after([(1, 1, 1)] * 20, PAPER.replace(usual_frames=10))
    judge_frame(judge, (1, 0.01, 0.01))
    assert judge.long_term_means == pytest.approx((1, 1))
    judge_frame(judge, (1, 2.0, 1.5))
    assert judge.long_term_means == pytest.approx((1.1, 1.05))


# --- status by confidence ---

BY_CONFIDENCE = MFCMTConfig.default().replace(
    tracking_threshold=0.5, hysteresis=0.1, lost_threshold=0.2, lost_after=3, usual_threshold=0.0
)


def statuses(confidences, config=BY_CONFIDENCE):
    """Return the verdicts on frames with these confidences, whose peaks are all alike."""
    reliability = Reliability(config)
    return [reliability.judge(Peaks(1, 1, 1), confidence) for confidence in confidences]


def test_the_status_follows_from_the_confidence():
    verdicts = statuses([0.9, 0.5, 0.49, 0.3])
    assert [v.status for v in verdicts] == ["tracking", "tracking", "uncertain", "uncertain"]
    assert [v.reliable for v in verdicts] == [True, True, False, False]
    assert all(v.learnable for v in verdicts)  # the three tests decide over that


def test_it_takes_more_confidence_to_come_back_to_tracking():
    assert [v.status for v in statuses([0.4, 0.55, 0.6, 0.5])] == ["uncertain", "uncertain", "tracking", "tracking"]


def test_a_target_is_lost_after_enough_frames_of_low_confidence_in_a_row():
    verdicts = statuses([0.1, 0.1, 0.2, 0.1, 0.1, 0.1, 0.55])
    assert [v.status for v in verdicts] == ["uncertain"] * 5 + ["lost"] * 2
    assert not any(v.learnable for v in verdicts[-2:])


def test_the_confidence_in_the_old_box_of_a_lost_target_is_low():
    """The candidate may look well; it was not taken."""
    assert statuses([0.1, 0.1, 0.1, 0.55])[-1].confidence == 0.2


def test_a_lost_target_is_found_at_the_confidence_that_tracking_takes():
    verdicts = statuses([0.1, 0.1, 0.1, 0.6])
    assert (verdicts[-1].status, verdicts[-1].confidence, verdicts[-1].reliable) == ("tracking", 0.6, True)


def test_a_frame_that_fails_a_test_is_not_reliable_however_confident():
    reliability = Reliability(BY_CONFIDENCE)
    reliability.judge(Peaks(1, 1, 1), 0.9)
    verdict = reliability.judge(Peaks(1, 0.1, 1), 0.9)
    assert (verdict.status, verdict.reliable, verdict.learnable) == ("tracking", False, False)


def test_learning_can_ask_for_confidence():
    config = BY_CONFIDENCE.replace(learn_threshold=0.3)
    assert [v.learnable for v in statuses([0.9, 0.3, 0.29], config)] == [True, True, False]


def test_a_start_on_nothing_is_uncertain():
    assert Reliability(BY_CONFIDENCE).start(0.1) == "uncertain"
    assert Reliability(BY_CONFIDENCE).start(1.0) == "tracking"
    assert Reliability(PAPER).start(0.1) == "tracking"


def test_frames_that_fail_a_test_are_counted_whatever_the_confidence():
    """A low template peak has the tracker probe one side after another, by this count."""
    reliability = Reliability(BY_CONFIDENCE)
    reliability.judge(Peaks(1, 1, 1), 0.9)
    runs = []
    for peak in (0.1, 0.01, 0.001, 1.0):
        reliability.judge(Peaks(peak, peak, peak), 0.9)
        runs.append(reliability.unreliable_run)
    assert runs == [1, 2, 3, 0]
