"""The one harness for whatever starts nodes: tests of nodes, of the system and of bags, and the benchmarks."""

#: Longest wait for a condition [s]. It ends what would hang, and bounds no speed: a busy machine may take its time.
PATIENCE = 300.0
