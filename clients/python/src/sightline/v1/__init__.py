"""The wire types, generated from `proto/sightline/v1` by `clients/python/generate.py`."""
