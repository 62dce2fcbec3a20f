"""Maps of one lane, over a period or from crossing to crossing."""
