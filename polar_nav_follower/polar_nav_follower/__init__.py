"""The follower: navigates with late acoustic fixes, each fused at its time of validity."""
