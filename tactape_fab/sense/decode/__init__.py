"""Depth map in, position out: which tape is touched, where, at what angle, and how likely that is wrong."""
