"""Settings: named, bounded, refused by name; all of them in the help."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from pydantic import ValidationError

from mfcmt_core.cli import main
from service import environment
from service.app import local_lanes
from service.auth import Authenticator
from service.protocol.problems import ProblemError
from service.settings import Settings

SHOW = "import os; print(os.environ)"


@pytest.fixture(autouse=True)
def _bare(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list(os.environ):
        if name.startswith("MFCMT_") and name != "MFCMT_CI":
            monkeypatch.delenv(name)


def test_defaults_suit_one_machine() -> None:
    settings = Settings()
    assert (settings.host, settings.port) == ("127.0.0.1", 8000)
    assert settings.capacity == settings.lanes * settings.max_sessions_per_lane


def test_variables_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MFCMT_LANES", "3")
    monkeypatch.setenv("MFCMT_API_KEYS", "first-key-0000001, second-key-000002")
    monkeypatch.setenv("MFCMT_ALLOWED_ORIGINS", "https://A.example,http://b.example:81")
    settings = Settings()
    assert settings.lanes == 3
    assert [key.get_secret_value() for key in settings.api_keys] == ["first-key-0000001", "second-key-000002"]
    assert settings.allowed_origins == ("https://a.example", "http://b.example:81")
    assert "first-key" not in repr(settings)


def test_what_a_service_was_set_up_with_leaves_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever it starts does not inherit it; settings that are read again are the same."""
    monkeypatch.setattr(environment, "_taken", {})
    monkeypatch.setenv("MFCMT_API_KEYS", "first-key-0000001")
    monkeypatch.setenv("mfcmt_admin_key", "the-operators-key")
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_HEADERS", "authorization=the-collectors")
    monkeypatch.setenv("MFCMT_API_KEY", "first-key-0000001")  # misspelt
    monkeypatch.setenv("OTHER", "not of the service")
    before = Settings()
    local_lanes(before)
    seen = subprocess.run([sys.executable, "-c", SHOW], capture_output=True, text=True, check=True).stdout
    for secret in ("first-key-0000001", "the-operators-key", "the-collectors"):
        assert secret not in str(os.environ)
        assert secret not in seen
    assert "not of the service" in seen
    assert Settings() == before
    monkeypatch.setenv("MFCMT_API_KEYS", "second-key-000002")
    (key,) = Settings().api_keys
    assert key.get_secret_value() == "second-key-000002"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("MFCMT_LANES", "0"),
        ("MFCMT_LANES", "two"),
        ("MFCMT_PORT", "70000"),
        ("MFCMT_IDLE_TIMEOUT_S", "nan"),
        ("MFCMT_IDLE_TIMEOUT_S", "-1"),
        ("MFCMT_MAX_FRAME_BYTES", "1"),
        ("MFCMT_MAX_FRAME_PIXELS", "1000000000"),
        ("MFCMT_API_KEYS", "short"),
        ("MFCMT_API_KEYS", "a-key-that-is-long-enough-but-ö"),
        ("MFCMT_ADMIN_KEY", ""),
        ("MFCMT_ADMIN_KEY", "x"),
        ("MFCMT_ADMIN_KEY", "the-key-of-the-öperator"),
        ("MFCMT_ALLOWED_ORIGINS", "app.example"),
        ("MFCMT_ALLOWED_ORIGINS", "https://app.example/"),
        ("MFCMT_ALLOWED_ORIGINS", "https://user@app.example"),
        ("MFCMT_ALLOWED_ORIGINS", "*"),
        ("MFCMT_ALLOWED_ORIGINS", "null"),
        ("MFCMT_ALLOWED_ORIGINS", "app://"),
        ("MFCMT_PUBLIC_URL", "ftp://x"),
        ("MFCMT_LOG_LEVEL", "loud"),
    ],
)
def test_a_bad_setting_is_refused_by_its_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str, value: str
) -> None:
    monkeypatch.setenv(name, value)
    assert main(["serve"]) == 2
    printed = capsys.readouterr().err
    assert name in printed
    assert len(printed.splitlines()) == 1


def test_localhost_alone_lets_every_page_of_the_own_machine_in() -> None:
    """For development, where each tool serves pages at a port of its own; no other name, and no app's scheme."""
    authenticator = Authenticator(Settings(allowed_origins="localhost"), lambda: 0.0)
    host = {"host": "127.0.0.1:8000"}
    for origin in ("http://localhost:5173", "https://app.localhost", "http://127.0.0.1:3000", "http://[::1]:8081"):
        authenticator.check_browser({"origin": origin} | host)
    strange = (
        "http://localhost.evil.test",
        "http://192.168.1.7:5173",
        "capacitor://localhost",
        "http://127.0.0.1.evil.test",
        "null",
    )
    for origin in strange:
        with pytest.raises(ProblemError, match="add the origin to MFCMT_ALLOWED_ORIGINS"):
            authenticator.check_browser({"origin": origin} | host)
    with pytest.raises(ProblemError, match="http://localhost:5173"):
        Authenticator(Settings(), lambda: 0.0).check_browser({"origin": "http://localhost:5173"} | host)


@pytest.mark.parametrize(
    "origin",
    ["capacitor://localhost", "app://localhost", "tauri://localhost", "ionic://localhost", "app://obsidian.md:81"],
)
def test_apps_in_a_webview_can_be_allowed(origin: str) -> None:
    """They have origins of schemes of their own (Capacitor, Cordova, Tauri, Ionic)."""
    authenticator = Authenticator(Settings(allowed_origins=f"https://app.example,{origin.upper()}"), lambda: 0.0)
    authenticator.check_browser({"origin": origin, "host": "localhost:8000"})
    with pytest.raises(ProblemError, match="origin-refused"):
        authenticator.check_browser({"origin": origin + "1", "host": "localhost:8000"})


def test_beyond_loopback_needs_keys_or_a_word(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValidationError, match="MFCMT_ALLOW_UNAUTHENTICATED"):
        Settings(host="0.0.0.0")
    assert Settings(host="0.0.0.0", allow_unauthenticated=True).host == "0.0.0.0"
    assert Settings(host="::1").on_loopback
    monkeypatch.setenv("MFCMT_API_KEYS", "first-key-0000001")
    assert Settings(host="0.0.0.0").api_keys


def test_the_help_shows_every_setting(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["serve", "--help"])
    printed = capsys.readouterr().out
    for name, field in Settings.model_fields.items():
        assert f"MFCMT_{name.upper()}" in printed
        assert field.description
        assert field.description in printed


def test_every_limit_says_its_unit() -> None:
    units = ("_s", "_bytes", "_pixels", "_px", "_scans", "_frames", "_lane", "_session", "_keys", "_key", "_tickets")
    plain = ("max_tombstones", "max_connections", "max_streams", "max_refused_messages")
    for name in Settings.model_fields:
        if name.startswith("max_") or name.endswith(("timeout", "deadline", "grace")):
            assert name.endswith(units) or name in plain, name


def test_the_front_imports_no_pixels() -> None:
    """The whole application, and what `mfcmt serve` adds to it."""
    code = (
        "import sys, service.cli.serve, service.server, service.observability.logs; "
        "from service.app import create_app; from service.settings import Settings; create_app(Settings()); "
        "heavy = {'numpy', 'cv2', 'numba', 'scipy', 'simplejpeg', 'PIL'}; "
        "print(sorted(m for m in sys.modules if m.split('.')[0] in heavy "
        "or m.startswith('mfcmt_core') and m.split('.', 1)[1:] not in "
        "([], ['cli'], ['cli.variables'], ['errors'], ['images'], ['images.header'])))"
    )
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert printed.stdout.strip() == "[]"
