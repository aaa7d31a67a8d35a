"""A minimal diffusion policy, and a simulated task in which touch decides.

`world` is the task, `demonstrations` writes episodes of it, `encoders` trains tactile encoders
without labels, `network` is the policy, `training` fits it to `PolicyWindows`, and `rollouts`
runs it through `PolicyStream`.
"""
