"""Trains the segmenter and the autoencoder, on frames of any source."""
