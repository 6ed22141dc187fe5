"""Evidence over seeds: late fixes, the price of reserve, a MEMS vehicle, false alarms, a gap."""
