"""Cases of the group `gmc`, each against an answer that is not ours."""
