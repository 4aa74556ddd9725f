"""The parts that nodes share: how they run and end, parameters, health, peers and clients."""
