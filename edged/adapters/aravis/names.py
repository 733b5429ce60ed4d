"""The names by which cameras of many makers know one thing, the standard's present name first.

Sources: SFNC 2.7; SFNC 1.x for names with Abs and Raw, and for FrameRateEnable, IEEE1588, ExposureStart;
else the
makers' GenICam descriptions of 84 models, whose names stand in tools/cameramodels.json. A name is enough
where it
means the same to every maker; where it does not, the function that uses it says what else it looks at.
"""

from __future__ import annotations

EXPOSURE_TIME = ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw")
"""In us; all of these are, also raw."""
GAIN = ("Gain", "GainAbs")
"""In dB."""
RAW_GAIN = "GainRaw"
"""In steps of the model's own."""

FRAME_RATE = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
FRAME_RATE_ENABLE = ("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled")
FRAME_RATE_AUTO = "AcquisitionFrameRateAuto"

FRAME_TRIGGERS = ("FrameStart", "ExposureStart", "AcquisitionStart")
"""The trigger of one exposure. AcquisitionStart only where there is no other: the Basler pilot and, by its
TriggerControlImplementation "Legacy", the scout expose one frame for it."""
TRIGGER_DELAY = ("TriggerDelay", "TriggerDelayAbs")
TRIGGER_DELAY_ENABLE = "TriggerDelayEnabled"

DEBOUNCE_US = ("LineDebouncerTime", "LineDebouncerTimeAbs", "LineDebouncerTimeRaw", "LineFilterWidth")
DEBOUNCE_FILTER = "LineInputFilterSelector"
"""Blackfly S and Oryx: LineFilterWidth is that of the filter which this selects, Deglitch or Debounce."""

EXPOSURE_ACTIVE = ("ExposureActive", "Exposing")
"""What an output shows. Exposing: Allied Vision GC, GT, Mako, Manta,
which have SyncOut lines instead of lines."""

TEMPERATURE = ("DeviceTemperature", "TemperatureAbs", "SensorTemperature")

PTP = ("PtpEnable", "GevIEEE1588")
PTP_MODE = "PtpMode"
"""Allied Vision GC, GT, Mako, Manta: Off, Slave, Master, Auto."""
PTP_STATUS = ("PtpStatus", "GevIEEE1588Status")

BYTES_PER_SECOND = ("StreamBytesPerSecond", "DeviceLinkThroughputLimit")
"""What a camera paces itself by, whatever pause between packets it is told: Allied Vision, unless its
BandwidthControlMode says SCPD (GigE Camera and Driver Features, 2.0 page 39, 3.0 page 64); Blackfly S and
Oryx (installation guides, 5.3)."""

LIMIT_MODE = "DeviceLinkThroughputLimitMode"
"""Basler: without it "On" the limit is a number that nothing heeds (docs.baslerweb.com)."""

GAMMA_ENABLE = ("GammaEnable", "GammaEnabled")
