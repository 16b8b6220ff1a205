"""Sealed cases from a plant that shares nothing with torchid, their scores, and benchmarks."""
