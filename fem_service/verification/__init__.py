"""Cases of the group `structure`, each against an answer that is not ours."""
