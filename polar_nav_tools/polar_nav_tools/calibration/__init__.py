"""Constants of instruments and clocks out of a recording: misalignments, lever arms, delays."""
