"""A whole session by a client that was generated: type-checked against it, then run with URL, KEY and frames.

Prints what the calls gave as JSON.
"""

import base64
import io
import json
import pathlib
import sys

from mfcmt_api.api.frames import post_frame
from mfcmt_api.api.service import get_capabilities, livez, metrics, readyz
from mfcmt_api.api.sessions import create_session, delete_session, get_session, list_sessions
from mfcmt_api.api.snapshots import get_snapshot
from mfcmt_api.api.targets import add_target, correct_target, remove_target
from mfcmt_api.api.tickets import make_ticket
from mfcmt_api.api.trajectory import get_trajectory
from mfcmt_api.client import AuthenticatedClient
from mfcmt_api.models.box_body import BoxBody
from mfcmt_api.models.capabilities import Capabilities
from mfcmt_api.models.create_body import CreateBody
from mfcmt_api.models.create_form import CreateForm
from mfcmt_api.models.frame_body import FrameBody
from mfcmt_api.models.frame_form import FrameForm
from mfcmt_api.models.health import Health
from mfcmt_api.models.options import Options
from mfcmt_api.models.options_preset import OptionsPreset
from mfcmt_api.models.problem import Problem
from mfcmt_api.models.result import Result
from mfcmt_api.models.session import Session
from mfcmt_api.models.session_page import SessionPage
from mfcmt_api.models.target_answer import TargetAnswer
from mfcmt_api.models.ticket_answer import TicketAnswer
from mfcmt_api.models.ticket_body import TicketBody
from mfcmt_api.models.trajectory_answer import TrajectoryAnswer
from mfcmt_api.types import File

url, key, box_text, *paths = sys.argv[1:]
frames = [pathlib.Path(path).read_bytes() for path in paths]
box = [float(v) for v in box_text.split(",")]
client = AuthenticatedClient(base_url=url, token=key)


def image(index: int) -> File:
    return File(io.BytesIO(frames[index]), file_name="frame.jpg", mime_type="image/jpeg")


def coded(index: int) -> str:
    return base64.b64encode(frames[index]).decode()


form = CreateForm(frame=image(0), box=box_text, options=Options(preset=OptionsPreset.DEFAULT, label="generated"))
made = create_session.sync(client=client, body=form, idempotency_key="generated-1")
assert isinstance(made, Session)
several = create_session.sync(client=client, body=CreateForm(frame=image(0), boxes=json.dumps([box, box])))
assert isinstance(several, Session)
created = create_session.sync(client=client, body=CreateBody(frame=coded(0), boxes=[box]))
assert isinstance(created, Session)

results: list[Result | Problem | None] = [
    post_frame.sync(made.id, client=client, body=image(1), seq=1, ts="raw"),
    post_frame.sync(made.id, client=client, body=FrameBody(frame=coded(2), seq=2, ts=2.5)),
    post_frame.sync(made.id, client=client, body=FrameForm(frame=image(3))),
]
seqs = []
for result in results:
    assert isinstance(result, Result)
    assert len(result.targets[0].box) == 4
    seqs.append([result.seq, result.ts])

added = add_target.sync(made.id, client=client, body=BoxBody(box=box))
assert isinstance(added, TargetAnswer)
corrected = correct_target.sync(made.id, 0, client=client, body=BoxBody(box=box))
assert isinstance(corrected, TargetAnswer)
removed = remove_target.sync_detailed(made.id, added.target.id, client=client)

snapshot = get_snapshot.sync(made.id, client=client)
assert isinstance(snapshot, File)
restored = create_session.sync(client=client, body=snapshot)
assert isinstance(restored, Session)

past = get_trajectory.sync(made.id, client=client)
assert isinstance(past, TrajectoryAnswer)
ticket = make_ticket.sync(made.id, client=client, body=TicketBody(ttl_s=5))
assert isinstance(ticket, TicketAnswer)
page = list_sessions.sync(client=client)
assert isinstance(page, SessionPage)
now = get_session.sync(made.id, client=client)
assert isinstance(now, Session)
can = get_capabilities.sync(client=client)
assert isinstance(can, Capabilities)
alive, ready = livez.sync(client=client), readyz.sync(client=client)
assert isinstance(alive, Health)
assert isinstance(ready, Health)
exposed = metrics.sync(client=client)
assert isinstance(exposed, str)

ended = [delete_session.sync_detailed(each.id, client=client) for each in (made, created, several, restored)]
gone = get_session.sync(made.id, client=client)
assert isinstance(gone, Problem)
print(
    json.dumps(
        {
            "label": made.label,
            "several": len(several.targets),
            "seqs": seqs,
            "corrected": list(corrected.target.box),
            "removed": removed.status_code,
            "restored": restored.seq,
            "past": [each.seq for each in past.results],
            "ticket": ticket.ticket != "",
            "listed": len(page.sessions),
            "now": [now.seq, len(now.targets)],
            "protocol": can.protocol,
            "health": [alive.status, ready.status],
            "metrics": "mfcmt_sessions_active" in exposed,
            "ended": [answer.status_code for answer in ended],
            "gone": [gone.code, gone.status],
        }
    )
)
