"""Four faults that axe does not see: floods of live regions, lost focus, steps of a millisecond, a covered picture."""

from __future__ import annotations

import pytest

from .conftest import Open, loop
from .test_access import PHONE

pytestmark = loop


async def test_values_that_change_all_the_time_are_not_read_out(open_page: Open) -> None:
    """Only the announcer may speak while a run goes on, and it says what was lost or found."""
    async with open_page() as user:
        await user.choose("sample")
        await user.page.evaluate(
            """() => {
                window.spoken = [];
                const live = '[aria-live]:not([aria-live=off]), output, [role=status], [role=log], [role=alert]';
                new MutationObserver((list) => {
                    for (const { target } of list) {
                        const region = (target.closest ? target : target.parentElement)?.closest(live);
                        if (region && !region.hidden) window.spoken.push(region.id);
                    }
                }).observe(document.body, { subtree: true, childList: true, characterData: true });
            }"""
        )
        await user.page.click("#follow-suggestion")
        await user.frames(60)
        spoken = await user.page.evaluate("window.spoken")
        assert len(spoken) <= 4, spoken


async def test_the_focus_is_never_lost(open_page: Open) -> None:
    async with open_page() as user:
        await user.page.focus("#choose-sample")
        await user.page.keyboard.press("Enter")
        await user.until("document.documentElement.dataset.state === 'open'")
        assert await user.page.evaluate("document.activeElement.id") == "stage"
        await user.page.focus("#change-source")
        await user.page.keyboard.press("Enter")
        await user.until("document.documentElement.dataset.state === 'idle'")
        assert await user.page.evaluate("document.activeElement.id") == "choose-sample"


async def test_the_position_moves_by_frames_and_says_which(open_page: Open) -> None:
    async with open_page() as user:
        await user.choose("sample")
        await user.page.focus("#seek")
        for _ in range(10):
            await user.page.keyboard.press("ArrowRight")
        await user.until("document.getElementById('seek').getAttribute('aria-valuetext') === '0:00.3, frame 11 of 300'")
        await user.page.keyboard.press("ArrowLeft")
        await user.until("document.getElementById('seek').getAttribute('aria-valuetext').includes('frame 10 of 300')")


@pytest.mark.parametrize(
    "context",
    [{"viewport": {"width": 640, "height": 400}}, PHONE | {"viewport": {"width": 844, "height": 390}}],
    ids=["a laptop at 200 %", "a phone in landscape"],
)
async def test_nothing_covers_the_picture_of_a_low_window(open_page: Open, context: dict[str, object]) -> None:
    """The whole picture can be seen above the controls, and the page scrolls."""
    async with open_page(**context) as user:
        await user.choose("sample")
        await user.page.evaluate("document.getElementById('stage').scrollIntoView({block: 'start'})")
        edges = await user.page.evaluate(
            """() => {
                const place = (one) => document.querySelector(one).getBoundingClientRect();
                const [picture, bar] = ['#picture', '.transport'].map(place);
                return [picture.top, picture.bottom, bar.top];
            }"""
        )
        top, bottom, bar = edges
        assert top >= -1
        assert bottom <= bar + 1, edges
        assert bottom - top > 150
        assert await user.page.evaluate("getComputedStyle(document.getElementById('stage')).touchAction") != "none"
        assert await user.page.evaluate("document.documentElement.scrollHeight > innerHeight")
