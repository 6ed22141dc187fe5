"""The story of one acoustic fix: records of a bag -> `Story` -> words, a plot, a picture."""

from .records import FixRecords, load_records
from .story import Story, UnknownFixError, story_of

__all__ = ['FixRecords', 'Story', 'UnknownFixError', 'load_records', 'story_of']
