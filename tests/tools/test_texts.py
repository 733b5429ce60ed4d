"""The texts of the pages: complete in each language, and all of them used."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable
from pathlib import Path

import pytest
from fluent.runtime import FluentResource
from fluent.syntax.ast import Junk

from edged.adapters.web.texts import Texts
from edged.app.cameras import camera_facts
from edged.app.running import Running
from edged.domain.cell import CellPhase
from edged.domain.measurement import Reject, Status
from edged.errors import CaptureError
from edged.pictures.captions import REASONS, REMEDIES
from edged.plc.answers import NackReason
from edged.plc.registers import BLOCKS, ResultCode
from edged.robot.orientations import Convention

ROOT = Path(__file__).resolve().parents[2]
WEB = ROOT / "edged" / "adapters" / "web"
SETUP, RUN = WEB / "static" / "setup", WEB / "static" / "run"
SCRIPTS = {path.stem: path.read_text() for path in sorted([*SETUP.rglob("*.js"), *RUN.rglob("*.js")])}
FRAME = (WEB / "templates" / "index.html").read_text()
"""The frame of the Run page, which names its texts."""
FORMS = [WEB / "login.py", *(WEB / "templates" / f"{name}.html" for name in ("login", "invite"))]
"""Pages that the cell writes itself, which name their texts."""
ALL_SCRIPTS = "\n".join([*SCRIPTS.values(), FRAME, *(path.read_text() for path in FORMS)])
ENTRY = re.compile(r"^([a-z][a-z0-9-]*) =(.*(?:\n[ }].*)*)", re.MULTILINE)
VALUE = re.compile(r"\$(\w+)")
FOLDERS = {path.name.split(".")[0]: path.parent for path in SETUP.glob("*/*.ftl")}
"""The folders of the set-up pages, by page."""
PAGES = sorted(FOLDERS)
PARTS = ["", "login", "run", "registers", *PAGES]
"""Files of texts: around the set-up pages, of the log-in forms, of the Run page, of its register map, and
of each set-up page.
"""


def families(script: str) -> set[str]:
    """The beginnings of ids that are completed by a code: state-, why-, step-."""
    made = set(re.findall(r"`([a-z-]+-)\$\{", script))
    return made | {f"{name}-" for name in re.findall(r"\binWords\(\"([a-z-]+)\"", script)}


FAMILIES = families(ALL_SCRIPTS)
NAMED = re.compile(
    r"""aria-label=\$\{t\("([a-z0-9-]+)"[^<>]*?\)\}(?:[^<>]|=>)*>\s*\$\{t\("([a-z0-9-]+)"\)\}"""
)
"""An element with a visible text and a longer one for screen readers."""


def entries(part: str, language: str) -> list[tuple[str, str]]:
    """Ids and texts of a file, in its order."""
    folder = FOLDERS.get(part) or (RUN if part else SETUP)
    folder = WEB / "static" if part == "login" else folder
    path = folder / (f"{part}.{language}.ftl" if part else f"{language}.ftl")
    return [(name, text) for name, text in ENTRY.findall(path.read_text())]


ENGLISH = {part: dict(entries(part, "en")) for part in PARTS}
OTHERS = sorted({path.name.split(".")[-2] for path in (WEB / "static").rglob("*.ftl")} - {"en"})
TEXTS = {tag: {part: dict(entries(part, tag)) for part in PARTS} for tag in OTHERS}
"""The texts of each language except English, by file."""


def scripts_of(page: str) -> set[str]:
    """The modules of a page, with all that they import."""
    found, wanted = set(), [page]
    while wanted:
        name = wanted.pop()
        if name not in found and name in SCRIPTS:
            found.add(name)
            wanted += re.findall(r'(?:from|import) "[./]+/(\w+)\.js"', SCRIPTS[name])
    return found


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("language", OTHERS)
def test_every_language_says_what_english_says(language: str, part: str) -> None:
    """Every language has every text, with the same values in it."""
    assert list(ENGLISH[part]) == list(TEXTS[language][part])
    for name, text in ENGLISH[part].items():
        assert set(VALUE.findall(text)) == set(VALUE.findall(TEXTS[language][part][name])), name
        assert text.strip(), name
        assert TEXTS[language][part][name].strip(), name


@pytest.mark.parametrize("language", OTHERS)
def test_every_text_can_be_read(language: str) -> None:
    """No entry of a language has a syntax error."""
    for path in (WEB / "static").rglob(f"*{language}.ftl"):
        resource = FluentResource(path.read_text())
        assert [] == [entry for entry in resource.body if isinstance(entry, Junk)], path


OTHER_WORDS = {
    "ja": r"部品|誰|シグマ|(トリガ|フォルダ|ブラウザ|メモリ|レジスタ|サーバ)ー|設定中"
    r"|[ぁ-ヿ一-鿿}] ?[:,;?] ?[ぁ-ヿ一-鿿{]",
    "zh": r"标准件|良好工件|虚拟台(?!架)|[一-鿿}] ?[:,;?] ?[一-鿿{]",
}
"""Other words for the same thing, and the punctuation of another script."""


def test_one_thing_has_one_word() -> None:
    """The texts use the glossary's words of each language, and none of the words that they replaced."""
    table = (ROOT / "docs" / "explanation" / "glossary.md").read_text().split("| word | German |")[1]
    columns = zip(*(row.strip("| ").split(" | ") for row in table.splitlines()[2:]), strict=True)
    for language, words in zip(("de", "fr", "ja", "zh"), list(columns)[1:], strict=True):
        text = "\n".join(text for part in PARTS for text in TEXTS[language][part].values())
        assert len(words) > 15
        assert [] == [word for word in words if word.lower() not in text.lower()]
        assert None is (pattern := OTHER_WORDS.get(language)) or [] == re.findall(f".*(?:{pattern}).*", text)


def test_the_page_offers_each_language_that_has_texts() -> None:
    """The page offers exactly the languages that have texts."""
    (listed,) = re.findall(r"LANGUAGES = \{(.*?)\}", SCRIPTS["texts"])

    assert {"en", *OTHERS} == set(re.findall(r"(\w+): \"", listed))


@pytest.mark.parametrize("language", ["en", *OTHERS])
def test_no_text_stands_twice(language: str) -> None:
    """An id has one text in each language."""
    names = [name for part in PARTS for name, _ in entries(part, language)]

    assert len(names) == len(set(names))


@pytest.mark.parametrize("language", ["en", *OTHERS])
def test_a_longer_name_has_the_words_that_are_seen(language: str) -> None:
    """The name for screen readers contains the visible text of a button (WCAG 2.1, 2.5.3: label in name)."""
    texts = {name: text for part in PARTS for name, text in entries(part, language)}
    pairs = {(f"{name}-name", name) for name in texts if f"{name}-name" in texts}
    pairs |= set(NAMED.findall(ALL_SCRIPTS))
    assert len(pairs) > 25

    assert [] == [
        (texts[longer], texts[shown])
        for longer, shown in sorted(pairs)
        if texts[shown].strip().lower() not in texts[longer].lower()
    ]


@pytest.mark.parametrize("page", ["run", *PAGES])
def test_every_text_that_a_page_asks_for_comes_with_it(page: str) -> None:
    """Every text of a page is in its file or in the common one; of a family at least two are."""
    there = {**ENGLISH[""], **ENGLISH[page], **(ENGLISH["registers"] if page == "run" else {})}
    for script in scripts_of(page):
        for name in re.findall(r"\bt\(\s*\"([^\"]+)\"", SCRIPTS[script]):
            assert name in there, script
        for start in families(SCRIPTS[script]):
            assert 2 <= sum(name.startswith(start) for name in there), (script, start)


def test_every_text_of_the_run_pages_frame_is_there() -> None:
    """Every text and label of the Run page's frame has an id, and none is written into it."""
    there = {**ENGLISH[""], **ENGLISH["run"]}
    named = re.findall(r'data-(?:text|label)="([^"]+)"', FRAME)

    assert len(named) > 30
    assert [] == [name for name in named if name not in there]
    assert "aria-label=" not in FRAME


def spoken(family: str) -> set[str]:
    """The codes of a family that the Run page has a text for."""
    return {name.removeprefix(family) for name in ENGLISH["run"] if name.startswith(family)}


def coded(names: Iterable[str | None]) -> set[str]:
    """Codes in the form of ids."""
    return {re.sub("[^a-z0-9]+", "-", (name or "").lower()) for name in names}


def test_the_run_page_has_a_sentence_for_each_code() -> None:
    """Every status, reason, fault, phase and convention has a text; in English it is the command line's."""
    english = ENGLISH["run"]
    faults = {str(one.code) for one in subclasses(CaptureError)}
    assert {"100", "112"} <= faults
    assert faults | {"other"} == {
        name.removeprefix("fault-") for name in ENGLISH[""] if name.startswith("fault-")
    }
    assert coded(Status) == spoken("run-status-")
    assert coded(one.name for one in Convention) == spoken("run-convention-")
    assert coded(f"state-{phase}" for phase in CellPhase) <= set(ENGLISH[""])
    assert coded(one.name for one in Reject if one) == spoken("run-reject-")
    for family, told in (("run-reject-", REASONS), ("run-try-", REMEDIES)):
        for bit, words in told.items():
            (code,) = coded([bit.name])
            assert words == english[f"{family}{code}"].strip()
    assert coded(one.name for one in REMEDIES) | {"look"} == spoken("run-try-")


def test_the_page_of_cycles_has_a_text_for_each_reason() -> None:
    """Each reason of a result has a text on the page of cycles, which asks for all but the reserved one."""
    reasons = {str(bit.name) for bit in Reject if bit} | {"NOT_FOUND", "CAPTURE"}
    family = "cycles-reason-"

    assert coded(reasons) == {
        name.removeprefix(family) for name in ENGLISH["cycles"] if name.startswith(family)
    }
    (asked,) = re.findall(r"export const REASONS = \[(.*?)\]", SCRIPTS["recorded"], re.DOTALL)
    assert reasons - {"LOW_SCORE"} == set(re.findall(r'"(\w+)"', asked))


def test_the_run_page_has_a_text_for_each_fact() -> None:
    """Each group, fact and value of a fact has a text on the Run page, and there are no others."""
    sources = [inspect.getsource(made) for made in (Running.facts, Running._drift_facts)]  # noqa: SLF001  (part of it)
    groups = re.findall(r"groups(?:: .*)? = \{|groups\[\"([^\"]+)\"\]", "".join(sources))
    names = {*filter(None, groups), *re.findall(r"\"([^\"]+)\": ", "".join(sources))}
    names |= set(re.findall(r"\]\[\"([^\"]+)\"\] = ", "".join(sources)))
    told = "".join([*sources, inspect.getsource(camera_facts)])
    codes = set(re.findall(r"translatable\(\s*\"([^\"]+)\"", told)) - {"own-words"}
    codes |= {"holds", "drifts", "invalid"} | {f"clock-{kind}" for kind in ("ptp", "free-running")}
    codes |= {f"clock-{kind}-within" for kind in ("ptp", "free-running")}

    assert {"version", "Zenoh", "Recorder"} <= names
    assert coded(names) | {"left", "right"} == spoken("run-fact-")
    assert codes == spoken("run-told-")


def test_the_run_page_leads_to_the_same_pages_as_their_own_head() -> None:
    """Each page beside the steps has its link there, in the same order and by the same text."""
    beside = SCRIPTS["steps"].partition("BESIDE = [")[2].partition("\n];")[0]
    pages = re.findall(r"\{ id: \"(\w+)\"", beside)
    links = re.findall(r"href=\"/setup#/(\w+)\" data-text=\"([\w-]+)\"", FRAME)
    assert [(page, f"nav-{page}") for page in pages] == links


def test_the_plcs_page_has_words_for_each_reason_and_each_result() -> None:
    """Each NACK reason and each result code has a text, and there are no others."""
    for family, codes in (("plc-nack-", NackReason), ("plc-result-", ResultCode)):
        said = {name for name in ENGLISH["plc"] if name.startswith(family)}
        assert {family + code.name.lower().replace("_", "-") for code in codes} == said


def test_the_run_page_says_of_each_register_what_its_map_does() -> None:
    """Each register has its help as text, word by word in English, and there are no others."""
    english, said = {name: text.strip() for name, text in ENGLISH["registers"].items()}, set[str]()
    for block in BLOCKS:
        for register in block.registers:
            alike = re.sub(r"^([TJ])\d+_", r"\1_", register.name)
            alike = re.sub(r"_R[XYZ]$", "_ROTATION", re.sub(r"_NAME_\d+$", "_NAME", alike))
            (name,) = coded(["register-" + re.sub(r"(^|_)[XYZABC]$", r"\1AXIS", alike)])
            name = next((one for one in (f"{name}-{register.address // 100}", name) if one in english), "")
            name = name or "register-n-reject"
            codes = re.search(r"\d+ [A-Z][A-Z0-9_]+(?:, \d+ [A-Z][A-Z0-9_]+)*", register.help)
            text = english[name].replace("{ $codes }", codes[0] if codes else "")
            assert register.help == text.replace("{ $code }", register.name[2:]), register.name
            said.add(name)

    assert {"register-no-value", "register-none", "register-unknown"} == set(english) - said


def subclasses(kind: type[CaptureError]) -> list[type[CaptureError]]:
    """The class and all its subclasses."""
    return [kind, *(one for child in kind.__subclasses__() for one in subclasses(child))]


def test_every_text_around_the_pages_is_there() -> None:
    """Every text around the pages is in the common file."""
    for script in scripts_of("main"):
        for name in re.findall(r"\bt\(\s*\"([^\"]+)\"", SCRIPTS[script]):
            assert name in ENGLISH[""], script


def test_the_cell_can_read_the_texts_of_its_forms() -> None:
    """Each text of the forms is on one line, without markup, is named in a template, and is the same in a
    browser."""
    texts = Texts("login")
    named = {name for path in FORMS for name in re.findall(r'"((?:login|invite)-[a-z-]+)"', path.read_text())}
    for tag, entries_of in (("en", ENGLISH["login"]), *((tag, TEXTS[tag]["login"]) for tag in OTHERS)):
        say = texts.in_language(tag)
        for name, text in entries_of.items():
            values = {value: f"<{value}>" for value in VALUE.findall(text)}
            told = re.sub(r"\{ \$(\w+) \}", r"<\1>", text.strip())
            assert told == say(name, **values).unescape()
            assert "<" not in say(name, **values)
            assert "{" not in told

    assert {"en", *OTHERS} == set(texts.languages)
    assert set(ENGLISH["login"]) == named


def test_every_text_is_used() -> None:
    """Every text is used by its id, or as one of a family."""
    begun = tuple(FAMILIES)
    names = [name for part in PARTS for name in ENGLISH[part]]

    assert [] == [name for name in names if f'"{name}"' not in ALL_SCRIPTS and not name.startswith(begun)]


def test_every_page_has_texts() -> None:
    """Each page in the table of steps has script, styles and texts, TOPIC/NAME.js."""
    entered = dict(re.findall(r'\{ id: "(\w+)", topic: "(\w+)"', SCRIPTS["steps"]))

    assert len(entered) >= 2
    assert {page: folder.name for page, folder in FOLDERS.items()} == entered
    for page, folder in FOLDERS.items():
        ends = (".js", ".css", ".en.ftl", *(f".{tag}.ftl" for tag in OTHERS))
        assert {f"{page}{end}" for end in ends} <= {path.name for path in folder.iterdir()}
