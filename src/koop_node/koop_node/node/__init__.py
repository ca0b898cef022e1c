"""Parts of a managed node: parameters, entities, QoS, schedule, container."""
