"""Depth maps of a tape in contact with a sensor: what the decoder is tested on, and shares no code with.

Nothing here looks at a code or a symbol: parts stand where the tape, or a written CPL, says.
"""
