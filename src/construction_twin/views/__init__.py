"""What a person sees in terminal and rviz: texts, pictures, requests. Pure."""
