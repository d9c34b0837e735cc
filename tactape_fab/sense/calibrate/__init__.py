"""Calibration of a sensor from presses on a known tape: camera, noise, gel, and where the sensor is on its flange."""
