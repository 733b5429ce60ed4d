"""The PLC's side of the cell: the Modbus map and the handshake."""
