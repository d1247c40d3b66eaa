"""Cases `coupling/...` of `scalebridge verify`: what goes through the handshake, against theory and other codes."""
