"""Circles, slots and straight edges of one plane, fitted to the raw edges of both cameras."""
