"""Forward stepwise selection of effects: fits, likelihood, cross-validation, the error of a formula."""
