"""Acoustic packets: fields, encoding, decoding one by one and as columns."""
