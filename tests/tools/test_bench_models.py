"""The table of camera models, and virtual cameras made from it."""

from __future__ import annotations

from pathlib import Path

import bench_models
import pytest
from cameramodels import Feature, models, read_description
from helpers.needs import needs_aravis
from modelcamera import make_of

WITHOUT_TRIGGER = {"FLIR_A35", "FLIR_SC6700", "Teledyne_ShadoBox"}
ONE_OF_EACH_KIND = ("AVT_GC1350C", "Basler-acA2040-35gm", "PGR_Flea3_GE_28S4C", "Teledyne_ShadoBox")
BEGUN = ("AcquisitionStart", "AcquisitionStop", "Width", "PixelFormat")
DESCRIPTION = """camera-id
<RegisterDescription VendorName="Maker" xmlns="http://www.genicam.org/GenApi/Version_1_1">
  <Category Name="Root"><pFeature>Inside</pFeature></Category>
  <Category Name="Inside">
    <pFeature>GainRaw</pFeature><pFeature>PixelFormat</pFeature><pFeature>Other</pFeature>
  </Category>
  <Group>
    <Integer Name="GainRaw">
      <DisplayName>Gain (Raw)</DisplayName><pValue>Reg</pValue><Unit>dB</Unit>
    </Integer>
  </Group>
  <IntReg Name="Reg"><AccessMode>RO</AccessMode></IntReg>
  <Enumeration Name="PixelFormat">
    <EnumEntry Name="Mono8"/><EnumEntry Name="BayerRG12Packed"/>
  </Enumeration>
  <Integer Name="Other"/><Integer Name="Gain"/>
</RegisterDescription>"""


def test_a_description_is_read_to_its_facts(tmp_path: Path) -> None:
    """Of each listed, relevant feature kind, access through its register, unit, menu text and choices are
    read."""
    file = tmp_path / "maker.xml"
    file.write_text(DESCRIPTION)

    vendor, features = read_description(file)

    assert "Maker" == vendor
    assert (
        Feature("GainRaw", "integer", True, "dB", "Gain (Raw)", "", ()),
        Feature("PixelFormat", "enumeration", False, "", "", "", ("Mono8", "BayerRG12Packed")),
    ) == features


def test_every_model_of_the_table_becomes_a_camera() -> None:
    """All 84 models become cameras with a size and, nearly all, a trigger."""
    made = {model.name: make_of(model) for model in models()}
    assert 84 == len(made)
    names = {name: {node.name for node in make.features} for name, make in made.items()}
    assert all(
        {"AcquisitionStart", "AcquisitionStop", "Width", "PixelFormat"} <= own for own in names.values()
    )
    reached = {model.name for model in models() if model.transport != "CoaXPress"}
    assert WITHOUT_TRIGGER == {name for name in reached if "TriggerMode" not in names[name]}


@pytest.mark.long
@needs_aravis()
@pytest.mark.parametrize(
    "name", ["AVT_GC1350C", "Basler-acA2040-35gm", "PGR_Flea3_GE_28S4C", "Teledyne_ShadoBox"]
)
def test_the_driver_finds_its_way_by_the_names_of_a_model(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The driver works with one model of each kind: old names, raw gain, a fixed selector, no trigger."""
    monkeypatch.setattr(bench_models, "ADDRESSES", ("127.0.71.1", "127.0.71.2"))
    (model,) = (model for model in models() if model.name == name)
    row = bench_models.looked_at(model)
    assert [] == row.wrong
    assert "yes" == row.works["pair"]
