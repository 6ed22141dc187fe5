"""Identification of a vehicle's drag and of the current from late position fixes.

Use and triggers: docs/identification.md; equations: docs/derivations/identification.md.

- `params.IdentificationParams`: the parameters ``identify_*``, on top of the vehicle model's.
- `identifier.Identifier`: collects fixes, attitude and thrust; triggers; identifies.
- `window`: input of an identification. `published`, `robust`: the two methods.
- `verdict`: whether a result may be used, or a helpful manoeuvre. `triggers`: times.
"""
