"""Passwords of the status page and of OPC UA: Argon2 hashes (RFC 9106), as `edged password` makes them."""

from __future__ import annotations

import re
import unicodedata

from argon2 import PasswordHasher
from argon2.exceptions import Argon2Error, InvalidHashError

HASHER = PasswordHasher(time_cost=3, memory_cost=64 * 1024, parallelism=1)
"""The second recommended option of RFC 9106, 4 (64 MiB), in one lane: the other cores are the cell's."""
MIN_LENGTH = 8
_WORDS = """
abc abcd access account admin administrator adminadmin alexander andreas anlage asdf automation azerty
baseball batman berlin bonjour business camera charlie cheese computer daniel default deutschland dragon
edged engineer factory fanuc flower football freedom fussball geheim guest hallo hallohallo hello herbst
hockey hunter iloveyou internet jennifer jessica jordan kamera kuka letmein liebe line login loveme lovely
maintenance manager manufacturing maschine master mercedes michael michelle monkey muster mustermann mustang
nothing office operator orange passw pass passwd password passwort passwords patrick pepper plant pokemon
porsche princess produktion production purple qazwsx qwer qwert qwertz qwerty qwertyuiop roboter robot root
samsung samantha schatz schalke secret service setup shadow siemens simatic sommer spring starwars station
stefan summer sunshine superman superuser supervisor support system techniker temp test tester testtest
thomas trustno user viewer vision volkswagen wartung welcome werk whatever willkommen windows winter yaskawa
zugang zxcvbnm
"""
COMMON = frozenset(_WORDS.split())
"""Words that are guessed first: from lists of stolen passwords, and common in plants."""
ROWS = (
    "abcdefghijklmnopqrstuvwxyz",
    "01234567890",
    "qwertyuiopasdfghjklzxcvbnm",
    "qwertzuiopasdfghjklyxcvbnm",
)
LEET = str.maketrans("013457@$!", "oleastasi")


def hash_password(password: str) -> str:
    """Hash a password, for a `password_hash`; slow on purpose, with a new salt in each call."""
    return HASHER.hash(password)


def is_password(password_hash: str, password: str) -> bool:
    """Whether the hash is that of this password; False also for text that is no hash. As slow as hashing."""
    try:
        return HASHER.verify(password_hash, password)
    except (Argon2Error, InvalidHashError):
        return False


def why_weak(password: str, name: str = "") -> str:
    """Reason why a password is weak; "" if it is not.

    Weak is a common word or the user's name, with digits and signs around it or in place of letters; almost
    nothing but digits and signs; a row of keys or letters; or a repetition. name : of its user.
    """
    text = unicodedata.normalize("NFKC", password).casefold()
    core = re.sub(r"^[\W\d_]+|[\W\d_]+$", "", text)
    words = {core, core.translate(LEET), re.sub(r"[\W\d_]", "", text), text.translate(LEET)}
    names = {part for part in re.split(r"\W+", unicodedata.normalize("NFKC", name).casefold()) if part}
    if words & (COMMON | names | {"".join(names)}) or (len(core) < 4 and len(text) < 12):
        return "this is one of the passwords that are tried first: choose one of several words"
    rows = (row + row[::-1] for row in ROWS)
    if re.fullmatch(r"(.+)\1+", text) or any(text in row or text[::-1] in row for row in rows):
        return "this is a row of keys, or repeats itself: choose several words"
    return ""
