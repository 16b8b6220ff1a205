from torchid.app import main

main()
