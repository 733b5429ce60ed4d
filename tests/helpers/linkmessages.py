"""One example of each request that a page may send to the cell."""

from __future__ import annotations

from edged.link import requests as ask

EXAMPLES: tuple[ask.Asked, ...] = (
    ask.EnterSetup(name="Anna"),
    ask.RenewLease(token="t"),
    ask.LeaveSetup(token="t"),
    ask.EndSetup(name="Ben"),
    ask.TakePair(token="t"),
    ask.AdjustCamera(token="t", side="left", exposure_us=500.0),
    ask.ReadLimits(token="t", side="right"),
    ask.TryCameras(token="t", changes={}),
    ask.InstallRelease(author="Anna", note="another rig"),
    ask.TakeJob(number=1),
    ask.KeepBeside(token="t", what="marks"),
    ask.AskRegisters(),
    ask.AskExchanges(),
    ask.AskMetrics(),
    ask.Examine(),
    ask.Mend(what="reload"),
    ask.OnStage(route="PUT /stage", body={"showing": "part", "rings": {"left": 0.5}}),
)
