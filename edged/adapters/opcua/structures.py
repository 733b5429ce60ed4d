"""Structures of OPC 40100-1 that are sent or received, registered with asyncua under the specification's ids.

Names are the specification's. Annotations are asyncua's own types: it derives the wire format from them, and
its field `Encoding` says which of the optional fields are present.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC
from typing import cast

from asyncua import ua

from edged.adapters.opcua.nodes import VISION

EPOCH = ua.DateTime(1970, 1, 1, tzinfo=UTC)
NO = cast("ua.Boolean", False)  # a class of its own for mypy, a bool on the wire
NOTHING, NO_TEXT, UNDEFINED = ua.UInt32(0), ua.String(""), ua.Int32(0)


@dataclass
class BinaryIdBaseDataType:
    """Common fields of the identifiers of recipes and configurations."""

    Encoding: ua.UInt32 = field(default=NOTHING, repr=False, init=False, compare=False)
    Id: ua.String = NO_TEXT
    Version: ua.String | None = None
    Hash: ua.ByteString | None = None
    HashAlgorithm: ua.String | None = None
    Description: ua.LocalizedText | None = None


@dataclass
class RecipeIdExternalDataType(BinaryIdBaseDataType):
    """The plant's id of a recipe."""


@dataclass
class RecipeIdInternalDataType(BinaryIdBaseDataType):
    """The cell's id of a recipe: the name of a job."""


@dataclass
class ConfigurationIdDataType(BinaryIdBaseDataType):
    """Fingerprint of configuration, rig and jobs."""


@dataclass
class JobIdDataType:
    """Id of an execution, which the specification calls a job."""

    Id: ua.String = NO_TEXT


@dataclass
class ResultIdDataType:
    """Id of a result."""

    Id: ua.String = NO_TEXT


@dataclass
class _NamedByClient:
    Encoding: ua.UInt32 = field(default=NOTHING, repr=False, init=False, compare=False)
    Id: ua.String = NO_TEXT
    Description: ua.LocalizedText | None = None


@dataclass
class MeasIdDataType(_NamedByClient):
    """The client's id of a measurement."""


@dataclass
class PartIdDataType(_NamedByClient):
    """The client's id of a part."""


@dataclass
class ProductIdDataType(_NamedByClient):
    """The client's id of a product."""


@dataclass
class ProcessingTimesDataType:
    """Times from the exposure to the publication; durations in ms."""

    Encoding: ua.UInt32 = field(default=NOTHING, repr=False, init=False, compare=False)
    StartTime: ua.DateTime = EPOCH
    EndTime: ua.DateTime = EPOCH
    AcquisitionDuration: ua.Double | None = None
    ProcessingDuration: ua.Double | None = None


@dataclass
class ResultDataType:
    """A result with the ids of its job, recipe, configuration, part and measurement."""

    Encoding: ua.UInt32 = field(default=NOTHING, repr=False, init=False, compare=False)
    ResultId: ResultIdDataType = field(default_factory=ResultIdDataType)
    HasTransferableDataOnFile: ua.Boolean | None = None
    IsPartial: ua.Boolean = NO
    IsSimulated: ua.Boolean | None = None
    ResultState: ua.Int32 = UNDEFINED
    MeasId: MeasIdDataType | None = None
    PartId: PartIdDataType | None = None
    ExternalRecipeId: RecipeIdExternalDataType | None = None
    InternalRecipeId: RecipeIdInternalDataType = field(default_factory=RecipeIdInternalDataType)
    ProductId: ProductIdDataType | None = None
    ExternalConfigurationId: ConfigurationIdDataType | None = None
    InternalConfigurationId: ConfigurationIdDataType = field(default_factory=ConfigurationIdDataType)
    JobId: JobIdDataType = field(default_factory=JobIdDataType)
    CreationTime: ua.DateTime = EPOCH
    ProcessingTimes: ProcessingTimesDataType | None = None
    ResultContent: list[ua.Variant] | None = None


RESULT_KINDS: dict[str, ua.VariantType] = {
    "HasTransferableDataOnFile": ua.VariantType.Boolean,
    "IsPartial": ua.VariantType.Boolean,
    "IsSimulated": ua.VariantType.Boolean,
    "ResultState": ua.VariantType.Int32,
    "CreationTime": ua.VariantType.DateTime,
    "ResultContent": ua.VariantType.Variant,
}
"""Types of the fields of a result that are not structures."""

IDS: dict[type, tuple[int, int]] = {
    BinaryIdBaseDataType: (3019, 5027),
    RecipeIdExternalDataType: (3002, 5002),
    RecipeIdInternalDataType: (3013, 5268),
    ConfigurationIdDataType: (3008, 5090),
    JobIdDataType: (3016, 5008),
    ResultIdDataType: (3021, 5274),
    MeasIdDataType: (3015, 5006),
    PartIdDataType: (3004, 5013),
    ProductIdDataType: (3003, 5224),
    ProcessingTimesDataType: (3005, 5016),
    ResultDataType: (3006, 5018),
}
"""Node numbers of each structure and of its binary encoding."""

for _structure, (_number, _encoding) in IDS.items():
    ua.register_extension_object(
        _structure.__name__, ua.NodeId(_encoding, VISION), _structure, ua.NodeId(_number, VISION)
    )


def text_of(identifier: object) -> str:
    """Id in an identifier sent by a client; "" without one."""
    return str(getattr(identifier, "Id", None) or "")


def structure(value: object) -> ua.Variant:
    """Wrap a structure for sending."""
    return ua.Variant(value, ua.VariantType.ExtensionObject)
