"""Bags at an address (``s3://``, ``https://``): what is asked of a storage, and what is kept."""
