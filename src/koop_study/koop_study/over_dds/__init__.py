"""The headline runs again with the real nodes over DDS: are they the same runs?"""
