"""Noise of instruments out of a recording: by maximum likelihood, judged by a part held out."""
