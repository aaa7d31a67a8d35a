"""A minimal diffusion policy, and a simulated task in which touch decides.

`world` is the task, `demonstrations` writes episodes of it, `encoders` trains tactile encoders
without labels, `diffusion` and `policy` are the policy and how it is fitted to `PolicyWindows`,
`rollouts` runs it through `PolicyStream`, and `variants` puts all together.
"""
