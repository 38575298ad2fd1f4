"""The networks that see: the UNet that segments, and the autoencoder whose encoder gives features.

`inference` runs either one, `weights` reads and writes them with their cards. May import `sfol` and
the modules at the top of `vsr`; nothing of `hypervectors` or `training`.
"""
