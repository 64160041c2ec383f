"""The tables of docs/operations.md that come from the code, and the variables that docker/compose.yaml passes on.

``make guide`` writes them anew.
"""

from __future__ import annotations

import asyncio
import re
from pathlib import Path

from prometheus_client.parser import text_string_to_metric_families

from service.app import create_app
from service.settings import Settings

GUIDE = Path(__file__).resolve().parents[2] / "docs/operations.md"
COMPOSE = GUIDE.parents[1] / "docker/compose.yaml"
# The image says where the service listens and keeps its state, HTTPS is Caddy's; the others have a line of their own.
NOT_PASSED_ON = {
    "host",
    "port",
    "state_dir",
    "api_keys",
    "admin_key",
    "max_lane_rss_bytes",
    "tls_certificate",
    "tls_key",
}
MIB = 1024 * 1024
# Defaults that follow from the machine.
MADE = {"lanes": "by usable cores", "max_upload_bytes": "an eighth of the usable memory, 128 to 512 MiB"}


def settings_table() -> str:
    """Every field of Settings: its variable, its default, what it is."""
    rows = ["| variable | default | |", "|---|---|---|"]
    for name, field in Settings.model_fields.items():
        made = MADE[name] if field.default_factory else _told(field.default)
        rows.append(f"| `MFCMT_{name.upper()}` | {made} | {field.description} |")
    return "\n".join(rows)


def _told(value: object) -> str:
    if value in (None, "", ()):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float) and value >= MIB and value % MIB == 0:
        return f"{value:.0f} ({value / MIB:.0f} MiB)"
    return f"{value:g}" if isinstance(value, float) else str(value)


def metrics_text() -> str:
    """What a service that has just been made tells."""
    app = create_app(_Plain())
    return asyncio.run(app.state.service.exporter.text(""))[0].decode()


class _Plain(Settings):
    """Settings from nowhere."""

    @classmethod
    def settings_customise_sources(cls, *_: object, **__: object) -> tuple[()]:  # type: ignore[override]
        return ()


def metrics_table() -> str:
    """Every metric of ours: its name, what it counts, the labels that it has at the start."""
    rows = ["| metric | | |", "|---|---|---|"]
    for family in text_string_to_metric_families(metrics_text()):
        if not family.name.startswith("mfcmt_"):
            continue
        name = family.name + ("_total" if family.type == "counter" else "")
        values: dict[str, set[str]] = {}
        for sample in family.samples:
            for label, value in sample.labels.items():
                if label != "le":
                    values.setdefault(label, set()).add(value)
        labels = ", ".join(f"`{label}`" for label in values)
        rows.append(f"| `{name}` | {family.type}{f' by {labels}' if labels else ''} | {family.documentation} |")
    return "\n".join(rows)


def compose_variables() -> str:
    """Every setting that compose hands to the service where it is set."""
    return "\n".join(f"      MFCMT_{name.upper()}:" for name in Settings.model_fields if name not in NOT_PASSED_ON)


VARIABLES = re.compile(r"(      # table: variables .*?\n)(.*?)(\n      # end)", re.S)
TABLES = {"settings": settings_table, "metrics": metrics_table}


def block(name: str) -> re.Pattern[str]:
    """Where the table is in the guide."""
    return re.compile(rf"(<!-- table: {name} -->\n)(.*?)(\n<!-- end -->)", re.S)


def main() -> None:
    """Write the tables into the guide, and the variables into the compose file."""
    text = GUIDE.read_text(encoding="utf-8")
    for name, table in TABLES.items():
        made = table()
        text = block(name).sub(lambda found, made=made: found[1] + made + found[3], text)
    GUIDE.write_text(text, encoding="utf-8")
    compose = COMPOSE.read_text(encoding="utf-8")
    COMPOSE.write_text(VARIABLES.sub(rf"\1{compose_variables()}\3", compose), encoding="utf-8")


if __name__ == "__main__":
    main()
