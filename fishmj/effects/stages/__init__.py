"""Catalogue of effects by stage; each `Effect` of a file here is registered."""
