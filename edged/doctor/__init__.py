"""Finds likely problems of this machine before they stop a cell: each with finding, consequence and remedy.

    examination  all checks for a configuration, in order
    machine      kernel cache, clock, processor, disk, serial port, ports to listen on
    cameras      which cameras answer, at which address, and what controls them
    network      addresses, routes, MTU, bandwidth, receive buffers, reverse path filter
    encrypted    the OPC UA server, and the validity of certificates
    ourdaemon    the daemon that runs this cell
    firewall     whether images are let in
    pictures     a few test pictures
    host         access to this machine's state
    findings     `Check`, the result of one check

Checks only look and change nothing. A check that cannot be made (no permission, no such tool) is skipped and
says so; it is never reported as good.
"""
