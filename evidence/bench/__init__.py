"""`make bench`: how fast the default fit is, beside what others need for the same leg."""
