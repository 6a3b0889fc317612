"""Whole runs: the chain from an experiment file to a results folder."""
