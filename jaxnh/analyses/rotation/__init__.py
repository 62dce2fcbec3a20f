"""Rotation numbers: weighted Birkhoff averages of the angle that motions advance by, and the fractions they lock to."""
