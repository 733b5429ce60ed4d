"""What a PLC sees: the Modbus map, the handshake, and client programs written from both."""
