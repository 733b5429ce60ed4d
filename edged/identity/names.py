"""Names of users: which are the same to whoever types them, and which look the same to whoever reads them."""

from __future__ import annotations

import unicodedata

LATIN = {
    **str.maketrans("АВЕЅІЈКМНОРСТХУҮԌԚԜ", "ABESIJKMHOPCTXYYGQW"),  # Cyrillic
    **str.maketrans("аесԁһіјӏоргԛѕѵхуүԝԍ", "aecdhijloprqsvxyywg"),
    **str.maketrans("ΑΒΕΖΗΙΚΜΝΟΡΤΥΧϹϺ", "ABEZHIKMNOPTYXCM"),  # Greek
    **str.maketrans("αγινορτυχϲϳ", "ayivoptuxcj"),
    **str.maketrans("ՍՏՕցհոսօզյ", "USOghnuoqj"),  # Armenian
    **str.maketrans("ıɩɑɡʏʀɪɴʜᴀᴄᴇᴊᴋᴍᴏᴘᴛᴜᴠᴡᴢ", "iiagyrinhacejkmoptuvwz"),  # Latin without a decomposition
}
"""Letters as the Latin ones that they are mistaken for: from confusables.txt of Unicode's Technical Standard
39, those of the scripts that stand beside Latin on keyboards."""
ALIKE = str.maketrans(
    {
        **dict.fromkeys("I1|ǀ∣", "l"),
        **dict.fromkeys("0O", "o"),
        **dict.fromkeys("‐‑‒–—―−", "-"),
        **dict.fromkeys("’‘ʼ`´", "'"),
        **dict.fromkeys("\u034f\u115f\u1160\u17b4\u17b5\u3164\uffa0", ""),  # printable, and nothing is seen
        **dict.fromkeys(map(chr, range(0xFE00, 0xFE10)), ""),
    }
)
"""Latin letters, digits and signs that most typefaces draw alike."""


def key_of(name: str) -> str:
    """The key by which names are compared: without case, width and other forms of compatibility (NFKC)."""
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())


def look_alike(name: str, other: str) -> bool:
    """Whether somebody could take one name for the other: as they stand, or in small letters."""
    return _skeleton(name) == _skeleton(other) or _skeleton(key_of(name)) == _skeleton(key_of(other))


def _skeleton(name: str) -> str:
    """What is seen of a name (UTS 39, section 4), with Latin letters."""
    letters = unicodedata.normalize("NFD", unicodedata.normalize("NFKC", name))
    return " ".join(letters.translate(LATIN).translate(ALIKE).split())
