"""Cases with a known answer for `scalebridge verify`."""
