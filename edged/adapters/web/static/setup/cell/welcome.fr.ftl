# Texts of welcome.js.
welcome-title = { $cell } : mise en service
welcome-new = Neuf étapes, des caméras dans leur carton à la pièce saisie. Une coche vient de ce que la cellule a, pas de ce qui a été cliqué.
welcome-complete = La cellule a tout ce qu’il faut pour mesurer. Chaque étape peut être regardée, et refaite.
welcome-done = Rien ne manque ici.
welcome-facts = Ce que la cellule a
welcome-later = À faire en ligne de commande
welcome-later-why = Ces étapes ne sont pas encore dans le navigateur. Le manuel donne les commandes.
next-cameras = Ensuite : les caméras
next-light = Ensuite : éclairage et netteté
next-calibrate = Ensuite : le calibrage
next-check = Ensuite : le contrôle
next-teach = Ensuite : apprendre une pièce
next-try = Ensuite : l’essayer
next-robot = Ensuite : le robot
next-plc = Ensuite : l’automate, et démarrer
fact-cameras = Caméras
fact-cameras-found =
    { $count ->
        [0] aucune trouvée
        [one] une trouvée
       *[other] { $count } trouvées
    }{ $troubled ->
        [0] { "" }
        [one] , une avec un problème
       *[other] , { $troubled } avec un problème
    }
fact-unknown = pas encore regardé
fact-rig-sigma = (±{ $sigma } µm là où des pièces ont été apprises)
fact-no-rig = aucun encore
fact-no-jobs = aucune encore
fact-plc = Automate
fact-plc-owner = écrit depuis
fact-no-plc = aucun n’a encore écrit
fact-machine = Cette machine
fact-machine-new = pas encore examinée
fact-machine-found = { $bad } mauvais, { $warn } à voir
fact-machine-look = Voir
fact-error = Défaut
manual-cameras = comment installer les caméras
manual-light = comment installer les caméras
manual-calibrate = comment calibrer
manual-check = comment contrôler
manual-teach = comment apprendre
manual-try = comment exploiter
manual-robot = comment recaler le robot
manual-plc = comment connecter un automate
