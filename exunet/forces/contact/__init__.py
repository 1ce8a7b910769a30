"""Contact of threads, nodes and bullets with rigid bodies; `exunet.forces.effects.contact` switches it on."""
