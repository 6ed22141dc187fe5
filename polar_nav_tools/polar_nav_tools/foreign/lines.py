"""YAML with comments, written line by line: no library keeps comments that were never there."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class Lines:
    """YAML with comments, as it grows."""

    lines: list[str] = field(default_factory=list)

    def put(self, text: str = '', indent: int = 0) -> None:
        """Add a line."""
        self.lines.append(' ' * indent + text if text else '')

    def say(self, text: str, indent: int = 0) -> None:
        """Add a comment."""
        self.put(f'# {text}', indent)
