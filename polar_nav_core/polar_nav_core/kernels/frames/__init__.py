"""Compiled geometry: earth, grid frame, strapdown, body axes, blocks of small matrices."""
