"""Tasks: observation, reward, randomisation and noise as pure functions, and the environments made from them."""
