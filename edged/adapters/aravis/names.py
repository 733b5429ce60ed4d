"""Names of the same feature on cameras of many makers, the standard's current name first.

Sources: SFNC 2.7; SFNC 1.x for names with Abs and Raw, and for FrameRateEnable, IEEE1588, ExposureStart; else
the makers' GenICam descriptions of 84 models, whose names are in tools/cameramodels.json. Where a name does
not mean the same to every maker, the function that uses it documents what else it checks.
"""

from __future__ import annotations

EXPOSURE_TIME = ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw")
"""Exposure time, us, under every one of these names, also the raw one."""
GAIN = ("Gain", "GainAbs")
"""Gain, dB."""
RAW_GAIN = "GainRaw"
"""Gain in steps that depend on the model."""

FRAME_RATE = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
FRAME_RATE_ENABLE = ("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled")
FRAME_RATE_AUTO = "AcquisitionFrameRateAuto"

FRAME_TRIGGERS = ("FrameStart", "ExposureStart", "AcquisitionStart")
"""Trigger of one exposure. AcquisitionStart only where there is no other: the Basler pilot and, with its
TriggerControlImplementation "Legacy", the scout expose one frame on it."""
TRIGGER_DELAY = ("TriggerDelay", "TriggerDelayAbs")
TRIGGER_DELAY_ENABLE = "TriggerDelayEnabled"

DEBOUNCE_US = ("LineDebouncerTime", "LineDebouncerTimeAbs", "LineDebouncerTimeRaw", "LineFilterWidth")
DEBOUNCE_FILTER = "LineInputFilterSelector"
"""Blackfly S and Oryx: selects the filter that LineFilterWidth belongs to, Deglitch or Debounce."""

EXPOSURE_ACTIVE = ("ExposureActive", "Exposing")
"""Source of an output during the exposure. Exposing: Allied Vision GC, GT, Mako, Manta, which have SyncOut
lines instead of lines."""

TEMPERATURE = ("DeviceTemperature", "TemperatureAbs", "SensorTemperature")

PTP = ("PtpEnable", "GevIEEE1588")
PTP_MODE = "PtpMode"
"""PTP switch of Allied Vision GC, GT, Mako, Manta: Off, Slave, Master, Auto."""
PTP_STATUS = ("PtpStatus", "GevIEEE1588Status")

BYTES_PER_SECOND = ("StreamBytesPerSecond", "DeviceLinkThroughputLimit")
"""Rate by which a camera paces itself, ignoring the pause between packets: Allied Vision, unless its
BandwidthControlMode is SCPD (GigE Camera and Driver Features, 2.0 page 39, 3.0 page 64); Blackfly S and Oryx
(installation guides, 5.3)."""

LIMIT_MODE = "DeviceLinkThroughputLimitMode"
"""Basler: unless it is "On", the limit has no effect (docs.baslerweb.com)."""

GAMMA_ENABLE = ("GammaEnable", "GammaEnabled")
