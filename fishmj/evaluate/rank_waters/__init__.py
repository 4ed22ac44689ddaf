"""Do two waters rank controllers alike?"""
