"""Trains the segmenter and the autoencoder, on frames of any source.

The last room of `vsr`: it may import all others, and nothing imports it but the street's tool that
draws frames.
"""
