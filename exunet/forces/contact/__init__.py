"""Contact of threads and bullets with rigid bodies; `exunet.forces.effects.contact` switches it on."""
