"""The other end of Zenoh, in a process of its own; knows Zenoh and nothing of edged.

    zenoh_peer.py listen CONFIG         prints a JSON line for every sample of every cell
    zenoh_peer.py get CONFIG SELECTOR   prints a JSON line for every reply
    zenoh_peer.py router CONFIG         routes

CONFIG: JSON object of Zenoh keys and values; "file" is a configuration to begin with. Prints "up"
when the session is open; ends when stdin does.
"""

from __future__ import annotations

import json
import sys
import time

import zenoh
import zenoh.ext


def say(**what: object) -> None:
    """Print one line for the test in one write, as subscribers call from several threads."""
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def config_of(text: str) -> zenoh.Config:
    """A configuration from the command line."""
    values = json.loads(text)
    file = values.pop("file", None)
    config = zenoh.Config.from_file(file) if file else zenoh.Config()
    for key, value in {"scouting/multicast/enabled": False, **values}.items():
        config.insert_json5(key, json.dumps(value))
    return config


def heard(sample: zenoh.Sample) -> None:
    """Print a sample."""
    kind = "put" if sample.kind == zenoh.SampleKind.PUT else "delete"
    text = sample.payload.to_string() if len(sample.payload) else "null"
    document = json.loads(text) if str(sample.encoding) in ("application/json", "zenoh/bytes") else None
    say(
        key=str(sample.key_expr),
        kind=kind,
        document=document,
        encoding=str(sample.encoding),
        heard_ns=time.time_ns(),
    )


def main() -> None:
    """Run the mode given on the command line."""
    what, config = sys.argv[1], config_of(sys.argv[2])
    session = zenoh.open(config)
    try:
        if what != "get":
            say(up=str(session.zid()))
        if what == "listen":
            late = zenoh.ext.HistoryConfig(detect_late_publishers=True)
            subscribers = [
                zenoh.ext.declare_advanced_subscriber(session, f"edged/*/{kind}", heard, history=late)
                for kind in ("target", "state")
            ]
            session.declare_subscriber("edged/*/health", heard)
            session.liveliness().declare_subscriber("edged/*/alive", heard, history=True)
            sys.stdin.read()
            for subscriber in subscribers:
                subscriber.undeclare()
        elif what == "get":
            for selector in sys.argv[3:]:
                for reply in session.get(selector, timeout=8.0):
                    answer = reply.ok or reply.err
                    say(
                        ok=reply.ok is not None,
                        document=json.loads(answer.payload.to_bytes()),
                        selector=selector,
                    )
            say(done=True)
        else:
            sys.stdin.read()
    finally:
        session.close()


if __name__ == "__main__":
    main()
