"""Start of a navigation: levelling, heading, place, until a filter can begin (docs/start.md)."""
