"""From period to period, or from crossing to crossing: maps of one lane."""
