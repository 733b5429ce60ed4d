"""Each brand and format is offered wherever a person chooses one."""

from __future__ import annotations

import re
from typing import get_args, get_type_hints

from edged.adapters.web.assets import read_assets
from edged.cli.around import registers
from edged.cli.options import BrandOption
from edged.config.servers import SocketSection
from edged.robot.orientations import CONVENTIONS, POSE_FIELDS, Brand
from edged.robot.pendant import PENDANTS
from edged.robots.formats import DOWNLOADS, FORMATS


def keys(script: str, name: str) -> set[str]:
    """The keys of an object in a page's script."""
    found = re.search(rf"\b{name} = {{\n(.*?)^}}", read_assets()[script], re.M | re.S)
    assert found is not None, script
    return set(re.findall(r"^  (\w+):", found[1], re.M))


def test_every_brand_is_offered() -> None:
    """Each brand is in the configuration, in options and on the page, with units, angles and a pendant."""
    brands = {str(brand) for brand in Brand}
    offered = {
        "edged/config/servers.py": set(get_args(SocketSection.model_fields["brand"].annotation)),
        "edged/cli/options.py": set(get_args(BrandOption)[1].help.split(", ")),
        "setup/shared/brands.js": keys("setup/shared/brands.js", "BRANDS"),
        "POSE_FIELDS": set(POSE_FIELDS),
        "PENDANTS": set(PENDANTS),
        "CONVENTIONS, ABB's quaternion beside them": {*CONVENTIONS, Brand.ABB},
    }

    assert dict.fromkeys(offered, brands) == offered


def test_every_format_is_offered() -> None:
    """Each format is in the help of `edged registers`, and with its maker's name on the page."""
    helped = get_args(get_type_hints(registers, include_extras=True)["format"])[1].help

    assert set() == set(FORMATS) - set(re.findall(r"\w+", helped)), "edged/cli/around.py"
    assert set() == set(DOWNLOADS) - keys("setup/cell/plc.js", "WHOSE"), "setup/cell/plc.js"
