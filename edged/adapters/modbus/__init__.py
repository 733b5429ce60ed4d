"""Modbus: results and status for PLCs and robots, and commands from them."""

from edged.adapters.modbus.publisher import ModbusPublisher
from edged.adapters.modbus.security import server_context
from edged.adapters.modbus.settings import LineSettings, ModbusSettings, SerialSettings, TlsSettings
