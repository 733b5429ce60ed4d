"""Rigid motions, lenses and two views: project, rectify, triangulate, and their derivatives."""
