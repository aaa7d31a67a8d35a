"""Tactile Prediction Pretraining in small: a tactile VAE and a latent diffusion over what it sees.

`data` turns windows into samples, `vae` compresses tactile images, `diffusion` adds noise and takes
it out, `denoiser` is the network between, `predictor` puts them together, `training` and
`evaluation` run it.
"""
