"""Simulated depth maps of a tape in contact with a sensor. The decoder is tested on them and shares no code with them.

Nothing here uses a code or a symbol: parts are at the places of the tape, or of a written CPL.
"""
