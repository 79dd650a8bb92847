"""The paper's inverse problem: readings of its geometry, disagreements, trade-off, evidence."""
