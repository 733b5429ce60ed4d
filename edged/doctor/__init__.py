"""Likely problems of this machine, before they stop a cell: each check with finding, consequence and remedy.

    examination  all checks for a configuration, in order
    machine      kernel cache, clock, processor, disk, serial port, ports to listen on
    cameras      who answers, at which address, who controls it
    network      addresses, routes, MTU, bandwidth, receive buffers, reverse path filter
    plc          the PLC whose memory is read and written
    firewall     what lets images in
    pictures     a few test pictures
    host         looking at this machine
    findings     `Check`

Checks look and do not change anything. What cannot be looked at (no right, no such tool) is skipped and
says so; it is never reported as well.
"""
