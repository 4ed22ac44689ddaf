"""The campaign: movements of a fish in the flow solver, drawn, run, kept. Every simpler water is fitted to them."""
