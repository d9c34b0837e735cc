"""Incoming inspection: the places of a tape's parts from a scan or a photograph of it. Needs OpenCV and SciPy."""
