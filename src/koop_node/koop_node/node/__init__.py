"""What makes a managed node: parameters, entities, QoS, schedule, container."""
