"""Identification of a vehicle's drag and of the current from late position fixes.

docs/identification.md says when and how, docs/derivations/identification.md derives it.

- `params.IdentificationParams`: the parameters ``identify_*``, on top of the vehicle model's.
- `identifier.Identifier`: collects fixes, attitude and thrust, says when it is time, identifies.
- `window`: what an identification works on. `published`, `robust`: the two methods.
- `verdict`: whether a result may be used, and which manoeuvre would help. `triggers`: when.
"""
