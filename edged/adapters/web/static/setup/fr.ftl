# Texts of the pages that set a cell up. Figures come with their unit from the page.

## Around every page
skip = Aller au contenu
nav = Pages
nav-run = Production
nav-setup = Mise en service
nav-jobs = Tâches
nav-cycles = Cycles
nav-marks = Repères
nav-accept = Réception
nav-space = 3D
nav-settings = Réglages
nav-system = Système
nav-manual = Manuel
menu = Compte et langue :
language = Langue
log-out = Se déconnecter
steps = Le chemin jusqu’à la pièce saisie
step-of = Étape { $number } sur { $count } :
foot = Étape précédente et étape suivante
understood = Compris
back = Retour
left = Gauche
right = Droite
state-starting = DÉMARRAGE
state-ready = PRÊTE
state-busy = OCCUPÉE
state-fault = DÉFAUT
state-stopping = ARRÊT
state-setup = RÉGLAGE
state-setup-by = RÉGLAGE par { $name }
state-setup-nobody = RÉGLAGE
plc-locked = AUTO_LOCK : l’installation compte sur cette cellule
plc-owner = Automate
plc-nobody = aucun automate connecté
connection-lost = Connexion à la cellule perdue : nouvel essai en cours
field-limits = Un nombre de { $low } à { $high } { $unit }
field-number = Un nombre, par exemple 0,5 ou 0.5

## Steps
step-welcome = Accueil
step-cameras = Caméras
step-light = Éclairage et netteté
step-calibrate = Calibrage
step-check = Contrôle
step-teach = Apprentissage
step-try = Essai
step-robot = Robot
step-plc = Automate et démarrage
state-tick = fait
state-doubt = à revoir
state-gap = manquant
state-open = pas commencé
state-none = inconnu ici

## Who has the cell
lease = Qui a la cellule
lease-free = La cellule mesure pour l’installation. Pour utiliser ses caméras, prenez-la : elle ne répond alors plus à aucun automate jusqu’à ce que vous la rendiez.
lease-incomplete = La cellule ne peut pas encore mesurer. Prenez-la pour la mettre en service.
lease-locked = L’installation compte sur cette cellule (AUTO_LOCK vaut 1) : personne ne peut la prendre. Passez d’abord l’installation en mode manuel.
lease-yours = Vous avez la cellule. Elle ne mesure rien pour l’installation tant que vous ne la rendez pas.
lease-elsewhere = Vous avez la cellule sur un autre écran. Continuez ici, et l’autre ne fera plus que regarder.
lease-others = { $name } a la cellule. Vous voyez les mêmes images et les mêmes chiffres, en direct.
lease-others-view = { $name } a la cellule. Vous voyez les mêmes images et les mêmes chiffres, en direct ; seul un ingénieur peut modifier quelque chose.
lease-view = Vous pouvez tout regarder. Seul un ingénieur peut modifier quelque chose.
lease-unattended = Personne ne s’occupe de la cellule. Elle ne mesure pas tant que quelqu’un ne s’est pas assuré que personne n’est à l’intérieur.
lease-take = Prendre la cellule
lease-take-over = Reprendre
lease-continue = Continuer ici
lease-leave = La rendre
lease-end = Terminer le réglage
idle = { $name }, vous êtes inactif depuis dix minutes : vous pouvez seulement regarder. Saisissez votre mot de passe pour continuer.
idle-wake = Je suis là
confirm-title = Votre mot de passe, s’il vous plaît
confirm = { $name }, cela change les droits de quelqu’un, ou ce avec quoi la cellule travaille. Saisissez votre mot de passe pour continuer.
confirm-yes = Continuer
password = Mot de passe
ask-take-title = Prendre la cellule ?
ask-take = La cellule termine le cycle en cours, puis READY tombe : chaque commande de l’automate est refusée jusqu’à ce que vous la rendiez.
ask-take-yes = La prendre
ask-over-title = Reprendre la cellule à { $name } ?
ask-over = { $name } en est averti, et ne peut alors plus que regarder. Le journal d’audit le note.
ask-over-yes = Reprendre
ask-leave-title = Rendre la cellule ?
ask-leave = Les réglages actifs reviennent, une paire d’essai est prise, puis la cellule est READY. Personne ne doit se trouver dans la cellule, et aucune mire ne doit y rester.
ask-leave-yes = La rendre
ask-end-title = Personne dans la cellule ?
ask-end = Confirmez seulement si vous avez regardé : la cellule devient alors READY, et l’installation peut démarrer.
ask-end-yes = J’ai regardé : personne n’y est

## What went wrong: cause and remedy
problem-other = Cela n’a pas marché : { $detail }
problem-unreachable = La cellule ne répond pas. Vérifiez le câble réseau et le PC de la cellule ; la page réessaie d’elle-même.
problem-page = Cette page n’a pas pu être chargée. Rechargez-la dès que la cellule répond.
problem-log-in = Vous n’êtes plus connecté. Connectez-vous à nouveau.
problem-origin = Le navigateur n’a pas dit de quelle page vient cette requête. Ouvrez la page par sa propre adresse.
problem-setup-refused = Impossible maintenant : { $detail }
problem-lease-lost = Vous n’avez plus la cellule : la ligne ci-dessus dit qui l’a. Ce que vous avez fait jusque-là est conservé.
problem-lease = Vous n’avez plus la cellule : la ligne ci-dessus dit qui l’a. Ce que vous avez fait jusque-là est conservé.
problem-role = Votre rôle ne le permet pas. Un ingénieur peut le faire.
problem-idle = Vous êtes inactif depuis dix minutes. Saisissez à nouveau votre mot de passe.
problem-password = Mot de passe incorrect.
problem-confirm = Votre mot de passe est encore une fois nécessaire.
problem-weak-password = Ce mot de passe se devine trop facilement. Choisissez-en un de plusieurs mots, sans votre nom.
problem-exists = Quelqu’un porte déjà ce nom, ou un nom qui a le même aspect.
problem-wait = Trop d’essais. Attendez { $wait_s } s.
problem-invalid = La cellule n’accepte pas cela : { $detail }
problem-unknown = Cela n’existe pas, ou n’existe plus. Rechargez la page.
problem-input = La cellule n’accepte pas cela : { $detail }
problem-storage = Le disque du PC de la cellule est plein. Libérez de la place, puis réessayez.
problem-stale = Cela a été modifié entre-temps, par quelqu’un d’autre ou sur un autre écran. Vous voyez maintenant la version la plus récente : vérifiez-la, puis refaites votre modification.
problem-regression = De bons cycles enregistrés deviennent ainsi mauvais, ou n’ont pas servi d’essai. Essayez sur la page Cycles, et mettez en service à partir de là.
problem-teach-name = Ce ne peut pas être un nom : utilisez des lettres, des chiffres, « _ », « . » et « - », en commençant par une lettre ou un chiffre.
problem-teach-name-taken = Il y a déjà une tâche { $name } : modifiez celle-là, ou choisissez un autre nom.
problem-teach-number-taken = { $number } est le numéro de { $name } ; { $free } est libre.
problem-teach-name-old = Les noms qui finissent ainsi appartiennent à des tâches remplacées : choisissez-en un autre.
problem-image-size =
    L’image { $side ->
        [left] gauche
       *[right] droite
    } a { $found } pixels, et le calibrage est pour { $wanted } : rétablissez ce format sur les caméras, ou calibrez-les telles qu’elles sont.
problem-task-failed = La cellule n’a pas pu terminer. Si cela se reproduit, consultez son journal (journalctl -u edged).
problem-task-too-large = Cela demande plus de mémoire ou de calcul que la cellule ne peut y consacrer, et a été arrêté : utilisez moins d’images ou de plus petites, ou un dessin plus petit.
problem-gone = Cette image n’est plus conservée. Prenez-en une nouvelle.
problem-status-404 = Cette cellule n’offre pas cela. Mettez edged à jour sur le PC de la cellule, puis rechargez cette page.
problem-status-500 = Une erreur interne de la cellule : consultez son journal (journalctl -u edged).

## Live pictures
live-left = Caméra gauche, en direct
live-right = Caméra droite, en direct
live-waiting = En attente de la première image.
live-watching = Une image apparaît dès que celui qui a la cellule regarde ses caméras.
live-take = Pas d’image : prenez la cellule pour voir ses caméras.

## On several pages
fact-rig = Calibrage
fact-jobs = Tâches
keep-what = C’est seulement un essai : les anciens réglages reviennent quand vous rendez la cellule, sauf si vous gardez ceux-ci.
keep-calibrate = Ces caméras sont seulement à l’essai. Le calibrage a été fait avec les précédentes : recalibrez, et la cellule prendra les deux ensemble.
keep = Garder
kept = Gardé.
board-title = Quelle mire ?
board-recognise = La reconnaître dans les images
board-state = L’indiquer moi-même
board-kind = Type
kind-chessboard = damier
kind-charuco = ChArUco
kind-dots = plaque de points
kind-circles = cercles décalés
board-columns = Coins intérieurs (ou points) par ligne
board-rows = Nombre de lignes
board-marker = Côté d’un marqueur
board-dictionary = Dictionnaire des marqueurs
board-mm = Côté d’une case
board-pitch = D’un point au suivant
board-goal = Objectif : un point du volume à ±
board-proof = Mesurez la longueur au pied à coulisse sur de nombreuses cases. Les images ne peuvent pas la prouver, et chaque coordonnée en dépend.
board-begin = Commencer
board-begin-auto = Commencer, et prendre les vues automatiquement
board-still = La mire est immobile.
board-moves = Tenez la mire immobile un instant.
view = Vue { $name }

## What becomes a release, and who signs for it
release-note = Pourquoi (pour qui le regardera plus tard)
release-making = Un instant …
sign-worse =
    { $count ->
        [one] Un cycle enregistré qui était bon deviendrait mauvais.
       *[other] { $count } cycles enregistrés qui étaient bons deviendraient mauvais.
    }
sign-untried =
    { $count ->
        [one] Ce n’a pas été essayé sur le cycle enregistré que cela concerne.
       *[other] Ce n’a pas été essayé sur les { $count } cycles enregistrés que cela concerne.
    }
sign-look = Les regarder
sign-try = Essayer sur eux
sign-what = Si c’est voulu, dites pourquoi : la raison reste avec la version, et dans le journal d’audit avec votre nom.
sign-reason = Pourquoi c’est acceptable
sign = Signer : { $label }

## The virtual stage of edged demo --stage
stage-title = Scène virtuelle : vos mains dans cette démonstration
stage-what = Ces caméras sont virtuelles. Ici vous faites ce que vos mains feraient dans une vraie cellule.
stage-board = La mire est un damier de { $columns } × { $rows } coins intérieurs ; le côté d’une case mesure { $mm } mm.
stage-show-board = Tenir la mire
stage-show-part = Poser la pièce
stage-show-nothing = Rien
stage-lay = Poser la pièce ailleurs
stage-truth = Le dernier résultat est décalé de { $x } µm en X, { $y } en Y, { $z } en Z.
stage-truth-none = L’erreur apparaît ici dès que la cellule mesure la pièce.
stage-hand = Amener la mire à l’endroit en pointillé
stage-still = Poser la mire
stage-follow = Suivre l’endroit en pointillé
stage-wave-left = Agiter la main devant la caméra gauche
stage-wave-right = Agiter la main devant la caméra droite
stage-ring-left = Bague de l’objectif gauche
stage-ring-right = Bague de l’objectif droit
stage-ring = { $turn } d’un quart de tour

## A picture that is looked at closely
zoom = Zoom
zoom-in = Plus près
zoom-out = Plus loin
zoom-all = Tout

## Drafts
draft-begun = Commencé auparavant
draft-go-on = Continuer
draft-go-on-with = Continuer avec { $name }
draft-discard = Supprimer
draft-discard-name = Supprimer { $name }
draft-discard-title = Supprimer { $name } ?
draft-broken = Il n’est plus lisible.

## Keys
keys = Clavier
keys-steps = À l’étape de ce numéro
keys-beside = À l’étape suivante, à la précédente
keys-main = Au bouton du bas
keys-undo = Annuler la dernière modification d’un brouillon
keys-redo = La refaire
keys-close = Fermer ce qui est ouvert
keys-list = Cette liste
keys-ctrl = Ctrl
keys-single = Les touches seules agissent (pas pendant la saisie)

## Faults of cameras, by the PLC's number
fault-other = Un défaut de la cellule.
fault-100 = Une caméra n’a rien livré.
fault-101 = Une caméra est introuvable ou ne répond pas : vérifiez son câble et son alimentation.
fault-102 = Un autre ordinateur pilote une caméra.
fault-103 = Une caméra refuse un réglage.
fault-104 = Aucune image n’est arrivée à temps : vérifiez le déclenchement, l’éclairage et le câble.
fault-105 = Une image est arrivée endommagée : des paquets se sont perdus sur le réseau. Vérifiez les câbles et le commutateur, et testez les paquets à la page « Caméras ».
fault-106 = Deux images ne viennent pas de la même exposition.
fault-107 = Une caméra a été éteinte puis rallumée.
fault-108 = Ce n’est pas la caméra calibrée : câbles ou adresses sont intervertis.
fault-109 = Une caméra a envoyé deux fois la même image.
fault-110 = Une caméra renvoie sans cesse la même image.
fault-111 = Une caméra a exposé, l’autre non.
fault-112 = Une caméra répond, mais n’envoie pas d’images.
fault-113 = Quelque chose a bougé entre les deux expositions, ou la lumière a changé : la pièce doit rester immobile.
measures-again = La cellule continue d’essayer : avec la prochaine paire correcte, elle mesure de nouveau.
draft-settings = Choisi, et pas encore en vigueur
draft-use = Utiliser ces réglages
draft-put = Les mettre en vigueur
draft-discarded = Le brouillon est abandonné.
draft-used = La cellule fonctionne avec ces réglages.
diff-nothing = rien
diff-yes = oui
diff-no = non
diff-option = { $name } : { $before } → { $after }
diff-password = { $name }: un autre mot de passe
